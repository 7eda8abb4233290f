"""The parts of the fit of a moving joint: regulators, plays, weights and the free run."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from allocator import BAR, DEG, AntagonistJoint, PrandtlIshlinskii, Table
from allocator.errors import InvalidInput
from allocator.identification.motion import loops
from allocator.identification.motion.problem import STIFFEST, MotionProblem, best_weights
from allocator.identification.motion.samples import MotionLog
from allocator.identification.motion.static import Difference, Equilibrium
from allocator.joint.hysteresis import FILLED
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N


def some_log(n=600, seed=0):
    rng = np.random.default_rng(seed)
    t = 0.05 * np.arange(n)
    P1, P2 = (np.repeat(rng.uniform(1, 4, n // 20), 20) * BAR for _ in range(2))
    return MotionLog(t, 0.6 * (P1 - P2) / (P1 + P2), P1, P2)


@pytest.mark.parametrize("slowest", [0.0, 0.1, 0.25])
def test_a_regulator_follows_as_its_differential_equation_says(slowest):
    t, u = np.array([0.0, 0.3, 1.0, 1.1, 2.0]), np.array([2.0, 4.0, 1.5, 3.0, 3.0]) * BAR
    found = loops.pressures(t, u, np.ones(t.size), 0.0, (0.2, 0.35, 0.12, 0.3 * BAR, slowest / BAR))

    def rate(at, P):
        error = u[max(np.searchsorted(t, at - 0.12, side="right") - 1, 0)] - P[0]
        error = np.sign(error) * max(abs(error) - 0.15 * BAR, 0.0)
        fastest = BAR / slowest if slowest else np.inf
        return [np.clip(error / (0.2 if error > 0 else 0.35), -fastest, fastest)]

    solved = solve_ivp(rate, (0, 2), u[:1], t_eval=t, rtol=1e-8, max_step=1e-3)
    np.testing.assert_allclose(found, solved.y[0], rtol=0, atol=2e-3 * BAR)


def test_motion_compresses_the_gas_as_its_differential_equation_says():
    """P' = (u - P)/τ - κ (P + p_a) V'/V   (G3), V given; steps of the rows are shorter than the lag."""
    t, kappa, around = np.arange(0.0, 3.0, 0.005), 1.3, 1.01e5
    u = np.where(t < 1.5, 2.0, 3.0) * BAR
    log_V = 0.2 * np.sin(2 * np.pi * 0.8 * t)
    squeezed = np.exp(-kappa / 2 * np.diff(log_V, prepend=log_V[:1]))
    found = loops.pressures(t, u, squeezed, around, (0.1, 0.1, 0.0, 0.0, 0.0))

    def rate(at, P):
        told = 2.0 * BAR if at < 1.5 else 3.0 * BAR
        return [(told - P[0]) / 0.1 - kappa * (P[0] + around) * 0.2 * 1.6 * np.pi * np.cos(2 * np.pi * 0.8 * at)]

    solved = solve_ivp(rate, (0, t[-1]), [2 * BAR], t_eval=t, rtol=1e-8, max_step=1e-3)
    assert np.ptp(solved.y[0]) > 0.5 * BAR
    np.testing.assert_allclose(found, solved.y[0], rtol=0, atol=0.01 * BAR)


@pytest.mark.parametrize("name", ["follow", "pass_plays", "swing"])
def test_the_loops_do_compiled_what_they_do_as_they_stand(name):
    log, r = some_log(), np.array([0.01, 0.03, 0.1])
    s = 0.3 + 0.7 * (log.P1 + log.P2) / FILLED
    if name == "follow":
        out, squeezed = np.empty(log.n), np.linspace(0.99, 1.01, log.n)
        loops.follow(log.t, log.P1, squeezed, 1e5, 0.1, 0.2, 0.07, 0.02 * BAR, 0.1 / BAR, out)
        found = loops.pressures(log.t, log.P1, squeezed, 1e5, (0.1, 0.2, 0.07, 0.04 * BAR, 0.1 / BAR))
    elif name == "swing":
        out, kappa = np.empty(log.n), np.array([0.5, 0.4, 0.3])
        loops.swing(log.theta, s, s, 1 / s, kappa, r, 0.02, 0.01, 0.05, np.zeros(3), out)
        found = loops.swung(log.theta, s, s, 1 / s, kappa, r, 0.02, 0.01, 0.05)
    else:
        out = PrandtlIshlinskii((0.4, 0.1, 0.2, 0.3), tuple(r), base=0.3).run(log.theta, log.P1 + log.P2)
        found = np.array([0.1, 0.2, 0.3]) @ loops.plays(log.theta, s, r) + 0.4 * log.theta
    np.testing.assert_allclose(found, out, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("most", [0.3, 0.9, 5.0])
def test_the_weights_satisfy_the_conditions_of_karush_kuhn_and_tucker(seed, most):
    rng = np.random.default_rng(seed)
    D = np.cumsum(rng.normal(size=(6, 200)), axis=1)
    y = rng.normal(size=6) @ D + 5 * rng.normal(size=200)
    w = best_weights(D, y, most)
    gradient = D @ (w @ D - y)  # of half the sum of squares
    scale = np.abs(D @ y).max()
    bound = w.sum() >= most * (1 - 1e-9)
    multiplier = max(-gradient[w > 0].mean(), 0.0) if bound and (w > 0).any() else 0.0
    assert (w >= 0).all()
    assert w.sum() <= most * (1 + 1e-12)
    assert (gradient + multiplier >= -1e-6 * scale).all()  # dual feasible
    np.testing.assert_allclose((gradient + multiplier)[w > 0], 0.0, atol=1e-6 * scale)  # complementary


@pytest.mark.parametrize(("springs", "own"), [((0.0, 0.0), False), ((0.6, 0.9), False), ((0.6, 0.9), True)])
def test_a_joint_swings_as_its_differential_equation_says(springs, own):
    """Forward Euler steps as fine as they have to be, by the text's equation, are what it is compared to."""
    log, h, fine = some_log(2000), 5e-3, 100
    kappa, r, a1, a2 = np.array(springs), np.array([0.02, 0.06]), 0.05, 0.01
    s, k = 0.4 + 0.6 * (log.P1 + log.P2) / FILLED, (log.P1 + log.P2) / (5 * BAR)
    found = loops.swung(log.theta, s, k, 1 / k if own else np.ones(log.n), kappa, r, a1, a2, h)
    theta, speed, e, expected = log.theta[0], 0.0, np.zeros(2), [log.theta[0]]
    for before, u, width, stiff in zip(log.theta[:-1], log.theta[1:], s[1:], k[1:], strict=True):
        for i in range(fine):
            driven = before + (u - before) * (i + 1) / fine
            speed += h / fine * (stiff * (driven - theta) - (1.0 if own else stiff) * kappa @ e - a1 * speed) / a2
            theta += h / fine * speed
            e = np.clip(e + h / fine * speed, -r * width, r * width)
        expected.append(theta)
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.01)


def test_a_joint_without_inertia_that_swings_is_the_operator():
    log = some_log()
    u, filled = np.cumsum(np.random.default_rng(2).normal(size=600)) * 0.01, np.full(600, FILLED)
    kappa, r = np.array([0.6, 0.9]), np.array([0.02, 0.06])
    operator = PrandtlIshlinskii((1 + kappa.sum(), *-kappa), tuple(r)).inverse
    found = loops.swung(u, *np.ones((3, log.n)), kappa, r, 0.0, 0.0, 0.02)
    np.testing.assert_allclose(found, operator.run(u, filled), rtol=0, atol=1e-8)


def test_a_stuck_joint_always_gives_a_little_so_that_the_operator_can_be_inverted():
    log = some_log()
    problem = MotionProblem.of(log, Difference(4 * BAR))
    run = problem.run(problem.start(0.1, np.ones(log.n, bool)), np.ones(log.n, bool))
    H = problem.operator(problem.start(0.1, np.ones(log.n, bool)), run.weights)
    assert H.weights[0] >= STIFFEST * (1 - 1e-9)
    assert H.gain == pytest.approx(1.0, abs=1e-12)


def rows(**changed):
    log = some_log(1000)
    given = {"t": log.t, "theta": log.theta, "P1": log.P1, "P2": log.P2}
    return {**given, **changed}


T = 0.05 * np.arange(1000)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"t": T[::-1]}, r"t\[1\] is not later"),
        ({"t": 20 * T}, "rows are 1 s apart"),
        ({"theta": 0.01 * np.sin(T)}, "theta stays within 1.1°.*step the pressures against each other"),
        ({"theta": np.clip(np.sin(T), -0.05, 0.05)}, "only .* rows are off the end stops, 2.86°, -2.86°"),
        ({"P2": np.full(1000, 2 * BAR)}, "P2 stays within 0 bar.*step both pressures"),
        ({"theta": 0.01 * T}, "theta turns round 0 times.*to and fro"),
        ({"t": 0.005 * np.arange(1000)}, "1000 rows over 5 s are too few"),
        ({"theta": 30 * np.sin(T)}, "over a turn; if degrees were meant"),
        ({"P1": 1 + np.sin(T) ** 2}, "if bar was meant"),
    ],
)
def test_a_log_that_tells_too_little_is_refused_with_what_would(changed, said):
    with pytest.raises(InvalidInput, match=said):
        MotionLog.checked(**rows(**changed))


def test_medians_take_noise_off_pressures_and_leave_steps_and_commands_where_they_are():
    given = rows()
    clean = MotionLog.checked(**given)
    np.testing.assert_array_equal(clean.P1, given["P1"])
    noise = 0.01 * BAR * np.random.default_rng(1).normal(size=1000)
    noisy = MotionLog.checked(**{**given, "P1": given["P1"] + noise})
    assert np.abs(noisy.P1 - given["P1"]).max() < 4 * 0.01 * BAR  # no step has moved
    assert np.abs(noisy.P1 - given["P1"]).mean() < 0.7 * np.abs(noise).mean()


def test_ramps_of_one_speed_cannot_tell_lag_from_hysteresis_and_steps_can():
    triangle = 0.8 * np.abs((T / 10) % 2 - 1)
    assert not MotionLog.checked(**rows(theta=triangle)).varies_speed
    assert MotionLog.checked(**rows(theta=np.sin(T))).varies_speed
    assert some_log().varies_speed
    assert MotionLog(**rows(theta=15 * DEG * np.sign(np.sin(T)))).varies_speed


def test_a_joint_that_rests_nowhere_at_these_pressures_is_not_the_joint_of_the_log():
    angles = np.linspace(-0.05, 0.05, 11)  # rad, as far as this mechanism was measured
    table = Table(0.40, angles, 0.13 + 0.04 * angles, 0.13 - 0.04 * angles)
    joint = AntagonistJoint(table, SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N)
    with pytest.raises(InvalidInput, match="it is not the joint of this log"):
        Equilibrium(joint, 5 * BAR)(np.array([2 * BAR]), np.array([3 * BAR]))


def test_all_spikes_and_drop_outs_are_left_out_and_noted():
    clean = MotionLog.checked(**rows())
    given = rows()
    given["theta"] = np.where(np.isin(np.arange(1000), (517, 801)), given["theta"] + 40 * DEG, given["theta"])
    given["P1"] = np.where(np.arange(1000) == 33, 30 * BAR, given["P1"])
    given["P2"] = np.where(np.arange(1000) == 700, 0.0, given["P2"])
    log = MotionLog.checked(**given)
    assert log.notes == ("rows with spikes were left out: theta[517], theta[801], P1[33], P2[700]",)
    assert (log.n, clean.n) == (1000, 1000)  # even times, the rows left out on a line between their neighbours
    kept = ~np.isin(np.arange(1000), (33, 517, 700, 801))
    np.testing.assert_allclose(log.theta[kept], clean.theta[kept], atol=1e-9)
    assert log.greatest_pressure == clean.greatest_pressure


def test_rounded_stamps_do_not_delay_the_commands_of_a_log_with_missing_rows():
    given = rows()
    kept = ~np.isin(np.arange(1000), np.arange(0, 1000, 37) + 1)
    late = 1e-7 * np.random.default_rng(0).uniform(-1, 1, 1000)
    log = MotionLog.checked(**{name: (a + late if name == "t" else a)[kept] for name, a in given.items()})
    there = np.flatnonzero(kept)[:-1]
    np.testing.assert_array_equal(log.P1[there], given["P1"][there])


def test_an_angle_that_wraps_is_to_be_unwrapped():
    with pytest.raises(InvalidInput, match=r"theta\[\d+\] is 3\d\d° from the row before it: a wrap .*numpy.unwrap"):
        MotionLog.checked(**rows(theta=np.mod(0.6 * np.sin(T), 2 * np.pi)))


@pytest.mark.parametrize("swings", [False, True])
def test_the_memory_begins_anew_after_a_gap(swings):
    """A log with a gap is predicted as its two parts are, each by itself."""
    swinging = {"damping": 0.03, "inertia": 0.01} if swings else {}
    values = {"lag_up": 0.1, "lag_down": 0.2, "dead_time": 0.02} | swinging
    whole = some_log(1000)
    log = replace(whole, t=whole.t + 3 * (np.arange(1000) >= 400))
    columns = ("t", "theta", "P1", "P2")
    halves = [replace(log, **{name: getattr(log, name)[part] for name in columns}) for part in log.parts]
    problem = MotionProblem(log, Difference(4 * BAR), tuple(values))
    springs = 0.3 * np.ones(problem.widths.size) if swings else []
    x = np.array([*values.values(), *springs, 0.0, 0.5, *np.zeros(len(problem.powers) - 2)])
    weights = problem.run(x, np.ones(1000, bool)).weights
    together = problem.elsewhere(log.t, (log.P1, log.P2), x, weights).theta
    apart = [problem.elsewhere(half.t, (half.P1, half.P2), x, weights).theta for half in halves]
    np.testing.assert_allclose(together, np.concatenate(apart), atol=1e-12)
    np.testing.assert_allclose(problem.run(x, np.ones(1000, bool)).theta, together, atol=1e-9)
    assert not problem.log.settled[[0, 400]].any()


def test_a_row_alone_between_gaps_is_refused():
    with pytest.raises(InvalidInput, match="a row stands alone between two gaps of more than 1 s"):
        MotionLog.checked(**rows(t=T + 3 * (np.arange(1000) >= 500) + 3 * (np.arange(1000) >= 501)))


def test_rows_at_uneven_times_are_filtered_at_even_ones():
    """A joint that swings: a filter over rows as they come would take every missing row for a quicker joint."""
    swinging = {"lag_up": 0.1, "lag_down": 0.1, "dead_time": 0.0, "damping": 0.03, "inertia": 0.01}
    even, rng = some_log(3000), np.random.default_rng(3)
    problem = MotionProblem(even, Difference(4 * BAR), tuple(swinging))
    stiff = np.zeros(problem.widths.size)
    x = np.array([*swinging.values(), *stiff, 0.0, 0.5, *np.zeros(len(problem.powers) - 2)])
    truth = problem.run(x, np.zeros(even.n, bool)).theta
    steps = np.diff(even.P1, prepend=0.0) != 0
    kept = np.flatnonzero(steps | (rng.random(even.n) < 0.5))
    t, commands = even.t[kept], (even.P1[kept], even.P2[kept])
    found = problem.elsewhere(t, commands, x, stiff).theta
    assert np.sqrt(np.mean((found - truth[kept]) ** 2)) < 0.02 * truth.std()
    log = MotionLog.checked(t, truth[kept], *commands)
    assert np.ptp(np.diff(log.t)) < 1e-9
    assert (log.P1 == even.P1[np.searchsorted(even.t, log.t + 1e-9) - 1]).all()
    assert np.sqrt(np.mean((log.theta - np.interp(log.t, even.t, truth)) ** 2)) < 0.15 * truth.std()
