"""The volume that a force law implies, (G1), with what it is held against: textbook, SciPy, differences, CasADi."""

from dataclasses import replace

import casadi
import numpy as np
import pytest
from scipy.integrate import quad

from allocator.errors import InvalidInput
from allocator.machine_file import load_joint, save_machine
from allocator.muscles import AffineMuscle, Hogan1984, KazemipourKatzschmann2025, Muscle, Sarosi2012, TonduLopez1995
from allocator.muscles.catalogue import MARTENS_DMSP_20_300, MUSCLES, SAROSI_DMSP_20_400N, TONDU_MCKIBBEN
from allocator.muscles.volume import usual_volume
from allocator.units import BAR, DEG

L = 0.40  # [m]


@pytest.fixture
def filled(muscle):
    """A muscle whose volume is known, whatever its law."""
    return replace(muscle, rest_volume=1.257e-4, tube_volume=2e-5)


def sampled(domain, n=6):
    P, eps = (a.ravel() for a in np.broadcast_arrays(*domain))
    some = np.linspace(0, P.size - 1, n).astype(int)
    return P[some], eps[some]


def test_the_volume_is_the_integral_of_the_gain_by_scipy(filled, domain):
    for P, eps in zip(*sampled(domain), strict=True):
        integral, _ = quad(lambda e, P=P: filled.gain(P, e), 0.0, eps, epsabs=0.0, epsrel=1e-13, limit=400)
        assert filled.volume(P, eps, L) == pytest.approx(1.457e-4 + L * integral, rel=1e-11)


def test_the_volume_grows_with_the_contraction_by_the_maxwell_relation(filled, domain):
    P, eps = domain
    h = 1e-5
    far, near = (filled.volume(P, eps + n * h, L) - filled.volume(P, eps - n * h, L) for n in (2, 1))
    difference = (8 * near - far) / (12 * h)
    gain = L * filled.gain(P, eps)
    assert np.abs(difference - gain).max() <= 1e-8 * np.abs(gain).max()


def test_its_slope_over_the_pressure_is_that_of_differences(filled, domain):
    P, eps = domain
    h = 10.0
    difference = (filled.gain_integral(P + h, eps) - filled.gain_integral(P - h, eps)) / (2 * h)
    slope = filled.gain_integral_slope(P, eps)
    scale = np.abs(filled.gain_integral(P, eps)).max() / BAR
    assert np.abs(slope - difference).max() <= 1e-6 * scale
    if isinstance(filled, AffineMuscle):
        assert not np.any(slope)


def test_the_slope_without_a_closed_form_is_that_with_one(filled, domain):
    P, eps = domain
    own, general = (f.gain_integral_slope(filled, P, eps) for f in (type(filled), Muscle))
    np.testing.assert_allclose(own, general, rtol=0, atol=1e-9 * np.abs(filled.gain_integral(P, eps)).max() / BAR)


@pytest.mark.parametrize("symbol", [casadi.SX, casadi.MX])
def test_numbers_and_symbols_hold_the_same_volume(filled, domain, symbol):
    P, eps = symbol.sym("P"), symbol.sym("eps")
    outputs = [filled.volume(P, eps, L), filled.gain_integral_slope(P, eps)]
    function = casadi.Function("V", [P, eps], outputs)
    P, eps = sampled(domain, 20)
    volume, slope = (np.asarray(x).ravel() for x in function.map(P.size)(P[None], eps[None]))
    np.testing.assert_allclose(volume, filled.volume(P, eps, L), rtol=1e-12)
    expected = filled.gain_integral_slope(P, eps)
    np.testing.assert_allclose(slope, expected, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("degrees", [20.0, 23.5, 30.0])
def test_the_ideal_mckibben_muscle_has_the_textbook_volume(degrees):
    muscle = TonduLopez1995(0.01, degrees * DEG)
    eps = np.linspace(-0.05, 0.35, 41)
    textbook = muscle.S * L * (1 - eps) * (muscle.b - muscle.a * (1 - eps) ** 2 / 3)  # a cylinder of turning threads
    np.testing.assert_allclose(muscle.volume(3e5, eps, L), textbook, rtol=1e-13)


def test_martens_and_boblans_cylinder_is_their_own():
    m, eps = MARTENS_DMSP_20_300, np.linspace(0, 0.26, 9)
    D = np.sqrt(m.fibre_length**2 - (m.L0 * (1 - eps)) ** 2) / (m.turns * np.pi)
    np.testing.assert_allclose(m.volume(2e5, eps, m.L0), np.pi / 4 * D**2 * m.L0 * (1 - eps), rtol=1e-12)


@pytest.mark.parametrize("d1", [0.0, 1e-6, 0.3, -0.8, 3.0, 400.0])
def test_the_pade_law_has_its_volume_whatever_its_denominator(d1):
    muscle = KazemipourKatzschmann2025(1500.0, -4000.0, 2000.0, d1, 5 * BAR, rest_volume=1.257e-4)
    for eps in (0.02, 0.26):
        integral, _ = quad(muscle.A, 0.0, eps, epsabs=0.0, epsrel=1e-13, limit=400)
        assert muscle.volume(3e5, eps, L) == pytest.approx(1.257e-4 + L * integral, rel=1e-12)


def test_a_cylinder_is_the_default_where_the_radius_is_known():
    assert TONDU_MCKIBBEN.volume_at_rest(L) == pytest.approx(np.pi * 1e-4 * L)
    assert SAROSI_DMSP_20_400N.volume_at_rest(L) == pytest.approx(125.7e-6, rel=1e-3)  # gas.md
    with_tube = replace(SAROSI_DMSP_20_400N, tube_volume=2e-5)
    assert with_tube.volume_at_rest(L) == pytest.approx(145.7e-6, rel=1e-3)
    assert replace(with_tube, inner_radius=0.02).volume_at_rest(0.1) == pytest.approx(np.pi * 4e-5 + 2e-5)
    with pytest.raises(InvalidInput, match=r"how much gas this Hogan1984 holds is not known.*rest_volume \[m³\]"):
        Hogan1984(1500.0, 0.3, 5e5).volume(3e5, 0.1, L)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"rest_volume": 0.0}, "Hogan1984: rest_volume = 0 m³ has to be positive"),
        ({"rest_volume": -1e-4}, "has to be positive"),
        ({"rest_volume": 0.1257}, "if litres were meant, pass 0.0001257"),
        ({"rest_volume": 125.7}, "if cubic centimetres were meant, pass 0.0001257"),
        ({"rest_volume": float("nan")}, "rest_volume = nan is not finite"),
        ({"rest_volume": "much"}, "rest_volume = 'much' is not a number"),
        ({"tube_volume": -1e-6}, "tube_volume = -1e-06 m³ has to be zero or more"),
        ({"tube_volume": 0.02}, "more than any tubing holds; if litres were meant, pass 2e-05"),
        ({"inner_radius": 10.0}, "inner_radius = 10 m is no muscle's radius; if millimetres were meant, pass 0.01"),
        ({"inner_radius": -0.01}, "is no muscle's radius"),
    ],
)
def test_a_volume_that_cannot_be_is_one_sentence(given, said):
    with pytest.raises(InvalidInput) as refusal:
        Hogan1984(1500.0, 0.3, 5e5, **given)
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_volumes_are_kept_in_the_files_of_muscles_and_joints_and_by_fitted_muscles(tmp_path):
    from allocator import Gas, Pulley
    from allocator.joint.antagonist import AntagonistJoint

    muscle = replace(SAROSI_DMSP_20_400N, rest_volume=1.2e-4, tube_volume=2e-5)
    muscle.save(tmp_path / "muscle.toml")
    assert Muscle.load(tmp_path / "muscle.toml") == muscle
    assert "rest_volume" not in (tmp_path / "muscle.toml").read_text().partition("[volume]")[0]
    joint = AntagonistJoint(Pulley(0.4, 0.02, 0.1375), muscle, SAROSI_DMSP_20_400N, gas=Gas(1.4, 9e4))
    save_machine(joint, tmp_path / "joint.toml")
    assert load_joint(tmp_path / "joint.toml") == joint
    moved = muscle.with_parameters({"c1": muscle.c1 * 1.01})
    assert (moved.inner_radius, moved.rest_volume, moved.tube_volume) == (0.01, 1.2e-4, 2e-5)


def test_a_muscle_is_the_same_law_however_much_gas_it_holds():
    assert SAROSI_DMSP_20_400N.same_law(replace(SAROSI_DMSP_20_400N, tube_volume=1e-5))
    assert not SAROSI_DMSP_20_400N.same_law(SAROSI_DMSP_20_400N.with_parameters({"c1": 0.0}))
    assert not SAROSI_DMSP_20_400N.same_law(TONDU_MCKIBBEN)


@pytest.mark.parametrize("name", MUSCLES)
def test_the_usual_volume_is_about_that_of_the_muscles_whose_radius_is_known(name):
    muscle, P, length = MUSCLES[name], 2.5 * BAR, 0.3
    V_0, radius = usual_volume(muscle, P, length)
    guessed = V_0 + length * muscle.gain_integral(P, 0.1)
    assert 0.95 < guessed / muscle.volume(P, 0.1, length) < 1.3
    assert 0.008 < radius < 0.013


def test_a_muscle_that_does_not_pull_has_no_usual_volume():
    pushing = Sarosi2012(c1=0.0, c2=-0.01, c3=-0.003, c4=0.0, c5=-100.0, c6=0.0)
    with pytest.raises(InvalidInput, match="gains no force"):
        usual_volume(pushing, 2.5 * BAR, 0.3)
