"""A muscle behind an elastic cable, against the minimum of the energy and springs in series."""

from dataclasses import replace

import casadi
import numpy as np
import pytest
from scipy.optimize import brentq

from allocator import allocate, report_joint, save_machine
from allocator.errors import InvalidFile, InvalidInput
from allocator.machine_file import load_joint
from allocator.mechanism import Mechanism
from allocator.muscles import Cabled, Muscle, Sarosi2012, scaled
from allocator.muscles.catalogue import MUSCLES, SAROSI_DMSP_20_400N
from allocator.units import BAR, CM3

L = 0.4  # [m]
STEEL, DYNEEMA, SOFT = 4e5, 1.5e5, 3e4  # [N/m]


def joint_with(stiffness, muscle=SAROSI_DMSP_20_400N):
    return replace(report_joint(muscle), agonist=Cabled(muscle, stiffness, L), antagonist=Cabled(muscle, stiffness, L))


@pytest.mark.parametrize("name", MUSCLES)
@pytest.mark.parametrize("stiffness", [2e4, DYNEEMA])
def test_the_muscle_pulls_as_hard_as_its_cable(name, stiffness):
    muscle = MUSCLES[name]
    cabled = Cabled(muscle, stiffness, L)
    for P, eps in ((3 * BAR, 0.05), (4 * BAR, 0.02), (5 * BAR, 0.08)):
        stretch = brentq(lambda s, P=P, e=eps: muscle.law(P, e + s / L) - stiffness * s, 0.0, 0.05, xtol=1e-15)
        assert cabled.law(P, eps) == pytest.approx(stiffness * stretch, rel=1e-9, abs=1e-9)


def test_stiffnesses_are_in_series():
    P, eps = np.linspace(1, 5, 5)[:, None] * BAR, np.linspace(0.02, 0.2, 7)
    cabled = Cabled(SAROSI_DMSP_20_400N, SOFT, L)
    at = eps + cabled.law(P, eps) / SOFT / L
    k = -SAROSI_DMSP_20_400N.slope(P, at) / L
    np.testing.assert_allclose(-cabled.slope(P, eps) / L, k * SOFT / (k + SOFT), rtol=1e-12)


@pytest.mark.parametrize("law", ["law", "gain", "slope", "gain_slope", "gain_integral", "gain_integral_slope"])
def test_numbers_symbols_and_complex_steps_agree(law):
    cabled = Cabled(replace(SAROSI_DMSP_20_400N, rest_volume=140 * CM3), SOFT, L)
    P, eps = (a.ravel() for a in np.meshgrid(np.linspace(0.5, 5, 4) * BAR, np.linspace(0.02, 0.2, 5)))
    p, e = casadi.SX.sym("P"), casadi.SX.sym("eps")
    function = casadi.Function("f", [p, e], [getattr(cabled, law)(p, e)])
    numbers = getattr(cabled, law)(P, eps)
    symbolic = np.asarray(function.map(P.size)(P[None], eps[None])).ravel()
    np.testing.assert_allclose(symbolic, numbers, rtol=1e-10, atol=1e-13 * np.abs(numbers).max())
    h = 50.0
    difference = (getattr(cabled, law)(P + h, eps) - getattr(cabled, law)(P - h, eps)) / (2 * h)
    stepped = np.imag(getattr(cabled, law)(P + 1e-30j, eps)) / 1e-30
    if law in ("law", "gain", "gain_integral"):  # whose derivatives by the pressure are taken somewhere
        np.testing.assert_allclose(stepped, difference, rtol=1e-4, atol=1e-6 * np.abs(numbers).max() / BAR)


def test_slopes_are_central_differences():
    cabled, h = Cabled(SAROSI_DMSP_20_400N, SOFT, L), 1e-5
    P, eps = np.linspace(1, 5, 5)[:, None] * BAR, np.linspace(0.02, 0.2, 7)
    pairs = {"gain": ("law", 1e-5 * P, 0.0), "slope": ("law", 0.0, h), "gain_slope": ("gain", 0.0, h)}
    for name, (law, dP, de) in pairs.items():
        difference = (getattr(cabled, law)(P + dP, eps + de) - getattr(cabled, law)(P - dP, eps - de)) / (2 * (dP + de))
        value = getattr(cabled, name)(P, eps)
        np.testing.assert_allclose(difference, value, atol=1e-7 * np.abs(value).max())


def test_a_hard_cable_is_none():
    P, eps = 3 * BAR, 0.1
    for law in ("law", "gain", "slope", "gain_slope"):
        hard = getattr(Cabled(SAROSI_DMSP_20_400N, 1e9, L), law)(P, eps)
        assert hard == pytest.approx(getattr(SAROSI_DMSP_20_400N, law)(P, eps), rel=1e-4)


def test_the_gas_fills_the_volume_of_the_contracted_muscle():
    cabled = Cabled(replace(SAROSI_DMSP_20_400N, rest_volume=140 * CM3), SOFT, L)
    P, eps = 3 * BAR, 0.1
    at = eps + cabled.law(P, eps) / SOFT / L
    assert cabled.volume(P, eps, L) == pytest.approx(140 * CM3 + L * SAROSI_DMSP_20_400N.gain_integral(P, at))
    h = 1e-6
    swelling = (cabled.volume(P, eps + h, L) - cabled.volume(P, eps - h, L)) / (2 * h)
    assert swelling == pytest.approx(L * cabled.gain(P, eps), rel=1e-7)  # (G1)
    slope = (cabled.gain_integral(P + 100, eps) - cabled.gain_integral(P - 100, eps)) / 200
    assert cabled.gain_integral_slope(P, eps) == pytest.approx(slope, rel=1e-6)


def test_the_joint_is_softer_by_what_the_reference_says():
    base, at = report_joint(SAROSI_DMSP_20_400N), (0.1, 3 * BAR, 2.5 * BAR)
    less = [joint_with(k).stiffness(*at) / base.stiffness(*at) - 1 for k in (STEEL, DYNEEMA, SOFT)]
    assert -0.03 < less[0] < -0.01
    assert -0.07 < less[1] < -0.03
    assert -0.25 < less[2] < -0.13
    shut = joint_with(SOFT).stiffness(*at, "shut") - joint_with(SOFT).stiffness(*at)
    assert 0 < shut < base.stiffness(*at, "shut") - base.stiffness(*at)


@pytest.mark.parametrize("stiffness", [DYNEEMA, SOFT])
def test_allocation_finds_pressures_for_the_stiffness_through_the_cables(stiffness):
    joint = joint_with(stiffness)
    a = allocate(0.1, 6.0, 1.0, joint=joint)
    assert a.success
    assert a.gap < 1e-9
    h = 1e-6
    torque = [joint.torque(0.1 + s * h, a.P1, a.P2) for s in (-1, 0, 1)]
    assert torque[1] == pytest.approx(1.0, abs=1e-9)
    assert (torque[0] - torque[2]) / (2 * h) == pytest.approx(6.0, rel=1e-7)


def test_a_stronger_muscle_keeps_its_cable():
    stronger = scaled(Cabled(SAROSI_DMSP_20_400N, SOFT, L), 1.2)
    assert stronger == Cabled(scaled(SAROSI_DMSP_20_400N, 1.2), SOFT, L)


def test_volume_and_covariance_are_of_the_whole():
    n = len(SAROSI_DMSP_20_400N.parameters)
    known = replace(SAROSI_DMSP_20_400N, covariance=np.eye(n), tube_volume=2e-5)
    cabled = Cabled(known, SOFT, L)
    assert cabled.covariance == known.covariance
    assert cabled.tube_volume == 2e-5
    assert replace(cabled, rest_volume=1e-4).rest_volume == 1e-4
    assert replace(cabled, covariance=None).covariance is None
    assert cabled.with_parameters({}).covariance is None


def test_a_file_keeps_the_cables(tmp_path):
    muscle = replace(SAROSI_DMSP_20_400N, rest_volume=140 * CM3)
    joint = joint_with(SOFT, muscle)
    save_machine(joint, tmp_path / "joint.toml")
    assert load_joint(tmp_path / "joint.toml") == joint
    joint.agonist.save(tmp_path / "muscle.toml")
    assert Muscle.load(tmp_path / "muscle.toml") == joint.agonist
    with pytest.raises(InvalidFile, match="a Sarosi2012 with a cable"):
        Sarosi2012.load(tmp_path / "muscle.toml")


def test_a_line_in_a_file_makes_the_joint_softer(tmp_path):
    path = tmp_path / "joint.toml"
    save_machine(report_joint(SAROSI_DMSP_20_400N), path)
    cable = "\n[muscle.cable]\ncable_stiffness = 3e4\nrest_length = 0.4\n\n[[muscle]]"
    first, second = path.read_text().split("[[muscle]]", 1)
    path.write_text(first + "[[muscle]]" + second.replace("\n[[muscle]]", cable))
    assert load_joint(path) == joint_with(3e4)
    path.write_text(path.read_text().replace("rest_length = 0.4\n\n", "rest_length = 0.3\n\n"))
    with pytest.raises(InvalidFile, match=r"rest_length = 0.3 m, which is 0.4 m long here"):
        load_joint(path)


def test_a_mechanism_takes_cables():
    joint = joint_with(SOFT)
    mechanism = Mechanism.from_joint(joint)
    K = mechanism.stiffness(np.array([0.1]), np.array([3 * BAR, 2 * BAR]))
    assert float(K[0, 0]) == pytest.approx(joint.stiffness(0.1, 3 * BAR, 2 * BAR), rel=1e-12)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((SAROSI_DMSP_20_400N, 40.0, L), "if N/mm was meant, multiply by 1000"),
        ((SAROSI_DMSP_20_400N, SOFT, 0.0), "rest_length = 0.0 has to be one number above 0"),
        ((Cabled(SAROSI_DMSP_20_400N, SOFT, L), SOFT, L), "has to be a muscle without a cable"),
    ],
)
def test_what_is_no_cable_is_refused(arguments, said):
    with pytest.raises(InvalidInput, match=said):
        Cabled(*arguments)
