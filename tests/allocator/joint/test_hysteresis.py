"""The Prandtl–Ishlinskii operator: against its definition written out, its closed inverse, and as friction."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allocator import PrandtlIshlinskii, report_joint, save_machine
from allocator.errors import InvalidFile, InvalidInput
from allocator.machine_file import load_joint
from allocator.units import BAR, DEG


def some(rng, n, base=None):
    thresholds = np.cumsum(rng.uniform(0.1, 3.0, n)) * DEG
    return PrandtlIshlinskii(rng.uniform(0.05, 1, n + 1), thresholds, base=base or rng.uniform(0.05, 1))


def signal(rng, m=300):
    return np.cumsum(rng.normal(size=m)) * DEG, rng.uniform(0, 10 * BAR, m)


@given(seed=st.integers(0, 10_000), n=st.integers(0, 8))
def test_the_inverse_gives_back_any_signal_whatever_the_pressures_do(seed, n):
    rng = np.random.default_rng(seed)
    H, (u, filled) = some(rng, n), signal(rng)
    np.testing.assert_allclose(H.inverse.run(H.run(u, filled), filled), u, rtol=0, atol=1e-10)
    np.testing.assert_allclose(H.run(H.inverse.run(u, filled), filled), u, rtol=0, atol=1e-10)
    back = H.inverse.inverse
    np.testing.assert_allclose((*back.weights, *back.thresholds), (*H.weights, *H.thresholds), rtol=1e-10)


def test_widths_that_do_not_shrink_are_those_of_independent_plays_as_textbooks_define_them():
    rng = np.random.default_rng(3)
    H = PrandtlIshlinskii((0.5, 0.3, 0.2), (1 * DEG, 4 * DEG), base=0.3)
    u, filled = signal(rng)[0], np.linspace(0, 8 * BAR, 300)
    expected, plays = [], [u[0], u[0]]
    for now, pressed in zip(u, filled, strict=True):
        widths = [r * (0.3 + 0.7 * pressed / (5 * BAR)) for r in H.thresholds]
        plays = [max(now - w, min(now + w, p)) for p, w in zip(plays, widths, strict=True)]
        expected.append(0.5 * now + 0.3 * plays[0] + 0.2 * plays[1])
    np.testing.assert_allclose(H.run(u, filled), expected, rtol=0, atol=1e-15)


def test_a_sweep_to_and_fro_is_a_loop_of_the_width_that_the_thresholds_say():
    H = PrandtlIshlinskii((0.25, 0.5, 0.25), (1.0 * DEG, 3.0 * DEG))
    u = np.concatenate([np.linspace(-30, 30, 601), np.linspace(30, -30, 601), np.linspace(-30, 30, 601)]) * DEG
    theta = H.run(u)
    down, up = theta[900], theta[1502]  # both at u = 0
    assert u[900] == pytest.approx(u[1502], abs=0.11 * DEG)
    assert down - up == pytest.approx(2 * (0.5 * 1 + 0.25 * 3) * DEG, abs=0.11 * DEG)


def test_symbols_arrays_and_numbers_give_the_same():
    import casadi as ca

    rng = np.random.default_rng(5)
    H = some(rng, 4)
    p, u, filled = rng.normal(size=(4, 7)), rng.normal(size=7), rng.uniform(0, 8 * BAR, 7)
    theta, plays = H.step(p, u, filled)
    symbols = ca.SX.sym("p", 4), ca.SX.sym("u"), ca.SX.sym("filled")
    step = ca.Function("step", [*symbols], [*H.step(*symbols)])
    for i in range(7):
        one, moved = (np.asarray(value).ravel() for value in step(p[:, i], u[i], filled[i]))
        np.testing.assert_allclose(one, theta[i], rtol=0, atol=1e-14)
        np.testing.assert_allclose(moved, plays[:, i], rtol=0, atol=1e-14)


def test_as_friction_its_springs_and_stops_make_up_what_the_static_angle_is_ahead():
    rng = np.random.default_rng(9)
    H, (u, filled) = some(rng, 4), signal(rng, 200)
    filled = np.sort(filled)  # widths that grow: the stops are independent
    theta, slip = H.run(u, filled), H.slip
    e, before = np.zeros(4), H.gain * u[0]
    for now, pressed, ahead in zip(theta, filled, u, strict=True):
        width = np.array(slip.widths) * H.scale(pressed)
        e, before = np.clip(e + now - before, -width, width), now
        lost = (1 / slip.gain - 1) * now + np.dot(slip.springs, e)
        assert lost == pytest.approx(ahead - now, abs=1e-12)


@pytest.mark.parametrize("more", [{}, {"stiffness": 5.0}])
def test_a_joint_keeps_its_hysteresis_in_its_file(tmp_path, more):
    joint = replace(report_joint(), hysteresis=PrandtlIshlinskii((0.6, 0.2, 0.2), (0.02, 0.06), base=0.2, **more))
    save_machine(joint, tmp_path / "joint.toml")
    assert load_joint(tmp_path / "joint.toml") == joint
    text = (tmp_path / "joint.toml").read_text(encoding="utf-8")
    (tmp_path / "wrong.toml").write_text(text.replace("thresholds", "widths"), encoding="utf-8")
    with pytest.raises(InvalidFile, match=r"\[hysteresis\] has no widths; it has weights, thresholds, base, stiffness"):
        load_joint(tmp_path / "wrong.toml")


@pytest.mark.parametrize(
    ("arguments", "base", "said"),
    [
        (((1.0, 0.5), ()), 1.0, "2 weights for 0 thresholds"),
        (((1.0, 0.5, 0.5), (0.2, 0.1)), 1.0, "have to be positive and to increase"),
        (((0.0, 0.5), (0.1,)), 1.0, "w_0 and all sums"),
        (((1.0, -1.5), (0.1,)), 1.0, "w_0 and all sums"),
        (((1.0, 0.5), (0.1,)), 0.0, "base = 0.0 has to be above 0"),
        ((1.0, ()), 1.0, "have to be a row of numbers"),
        (((1.0, 0.5), (12.0,)), 1.0, r"thresholds\[0\] = 12 rad is over a turn; if degrees were meant, pass 0.2094"),
        (((1.0, np.nan), (0.1,)), 1.0, r"weights\[1\] = nan is not finite"),
    ],
)
def test_what_cannot_be_inverted_is_refused_in_one_sentence(arguments, base, said):
    with pytest.raises(InvalidInput, match=said):
        PrandtlIshlinskii(*arguments, base=base)


def test_at_one_stiffness_its_springs_are_those_of_friction():
    H = PrandtlIshlinskii((0.6, 0.2, 0.2), (0.02, 0.06), base=0.2)
    own = replace(H, stiffness=5.0)
    shares, springs = H.slip, own.slip
    assert shares.elastic
    assert not springs.elastic
    np.testing.assert_allclose(springs.springs, 5.0 * np.array(shares.springs), rtol=1e-14)
    assert springs.widths == shares.widths
    joint = replace(report_joint(), hysteresis=own)
    for P in (1.5 * BAR, 4 * BAR):  # a push meets the same friction at any stiffness, but for its widths
        K = joint.stiffness(0.0, P, P)
        widths = np.array(springs.widths) * H.scale(2 * P)
        added = np.dot(springs.springs, np.minimum(1.0, widths / 0.05))
        assert joint.stiffness(0.0, P, P, amplitude=0.05) - K == pytest.approx(added, rel=1e-9)
    with pytest.raises(InvalidInput, match="at one stiffness have to add up to 1"):
        PrandtlIshlinskii((0.6, 0.2), (0.02,), stiffness=5.0)
    with pytest.raises(InvalidInput, match="stiffness = 0"):
        replace(H, stiffness=0.0)


def test_hysteresis_that_would_push_is_no_friction():
    with pytest.raises(InvalidInput, match="negative weight is no friction"):
        _ = PrandtlIshlinskii((1.0, -0.2), (0.1,)).slip
    with pytest.raises(InvalidInput, match="has to be a PrandtlIshlinskii"):
        replace(report_joint(), hysteresis=0.1)
    with pytest.raises(InvalidInput, match="has to be a row of angles"):
        PrandtlIshlinskii().run([[0.1]])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (([0.0, 0.3], [3.0, 4.0]), "if bar was meant"),
        (([0.0, 0.3], -8e5), r"filled\[0\] = -800000 Pa leaves no width to the plays"),
        (([0.0, 0.3], 5e5, np.zeros(3)), "have to be 2 angles"),
        (([0.0, 0.3], 5e5, [np.nan, 0.0]), r"plays\[0\] = nan is not finite"),
    ],
)
def test_what_it_cannot_run_through_is_one_sentence(arguments, said):
    with pytest.raises(InvalidInput, match=said):
        PrandtlIshlinskii((0.6, 0.2, 0.2), (0.02, 0.06), base=0.2).run(*arguments)


def test_a_history_that_is_no_pair_is_one_line():
    with pytest.raises(InvalidInput, match=r"history = ndarray\(40, 3\) of float64 has to be two pressures") as refusal:
        report_joint().equilibrium(2e5, 2e5, history=np.full((40, 3), 2e5))
    assert "\n" not in str(refusal.value)
