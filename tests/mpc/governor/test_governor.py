"""A governor keeps its limits whatever is commanded, leaves alone what is safe, and moves the rest least."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from allocator import Limits, report_joint
from allocator.errors import InvalidInput
from allocator.mechanism import Mechanism, Pulleys, machines
from allocator.muscles import Hogan1984
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG
from benchmarks.governor.closed_loop import COMMANDERS, closed_loop
from mpc.governor import GovernorStatus, Interval, PressureGovernor

from ...rigs.certificates import unexplained

pytestmark = pytest.mark.compiles

ARM = machines.arm26()
DT, SLEW = 0.01, 20 * BAR
GOVERNOR = PressureGovernor(ARM, DT, SLEW, inertia=(0.12, 0.04), lag=0.02, max_energy=2.0)


def states(N, seed=0, speed=2.0):
    """Arms (q, ω, P) with taut pressures, of which the joints' range or the energy is in danger or not."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.0, 1.0, (N, 2))
    return q, rng.normal(0, speed, (N, 2)), rng.uniform(*ARM.pressure_box(q)), rng


def within(q, safe, previous):
    """Whether commands keep supply, slew and, as far as the slew lets them, tautness."""
    reach, near = SLEW * DT, 1e-9 * 5 * BAR
    taut = np.clip(ARM.pressure_box(q)[0], previous - reach, previous + reach)
    return (safe >= np.maximum(taut, 0) - near) & (safe <= 5 * BAR + near) & (np.abs(safe - previous) <= reach + near)


def test_no_command_breaks_supply_slew_or_tautness():
    q, omega, P, rng = states(40)
    command = rng.uniform(-20, 20, P.shape) * BAR
    command[::5] = rng.choice([np.nan, np.inf, -np.inf, 1e300, -1e300], command[::5].shape)
    safe, status = GOVERNOR.govern(q, omega, P, command)
    assert within(q, safe, P).all()
    assert (status[::5] == GovernorStatus.BAD_INPUT).all()
    assert {GovernorStatus.MOVED, GovernorStatus.NOT_KEPT} <= {*status.tolist()}


def test_what_is_safe_is_not_touched_and_what_is_let_through_is_safe():
    q, omega, P, rng = states(40, seed=1, speed=0.7)
    q, P = 0.5 * q, np.clip(P, 2.0 * BAR, 3.5 * BAR)
    command = P + rng.choice([0.15, 0.3], (40, 1)) * rng.uniform(-1, 1, P.shape) * BAR
    safe, status = GOVERNOR.govern(q, omega, P, command)
    untouched = status == GovernorStatus.SAFE
    assert 0.3 < untouched.mean() < 1.0
    assert np.array_equal(safe[untouched], command[untouched])
    again, said = GOVERNOR.govern(q, omega, P, safe)
    kept = status <= GovernorStatus.MOVED
    assert np.array_equal(again[kept], safe[kept])
    assert (said[kept] == GovernorStatus.SAFE).all()


def test_a_command_that_asks_for_too_much_energy_is_moved_to_the_nearest_that_does_not():
    """The row is ½ ωᵀM ω + t ω·τ(u) ≤ E; multipliers prove that nothing is nearer. There is no range."""
    arm, M, t = replace(ARM, angle_limits=None), np.diag([0.12, 0.04]), 0.02 + DT
    governor = PressureGovernor(arm, DT, SLEW, inertia=(0.12, 0.04), lag=0.02, max_energy=2.0)
    q, omega, P, rng = states(40, seed=2)
    omega *= np.sqrt(rng.uniform(1.0, 2.0, 40) / (omega**2 @ M.diagonal() / 2))[:, None]
    command = P + rng.uniform(-0.15, 0.15, P.shape) * BAR
    safe, status = governor.govern(q, omega, P, command)
    checked = 0
    for i in np.flatnonzero(status == GovernorStatus.MOVED):
        lo, hi = arm.pressure_box(q[i], Limits(previous=P[i], max_step=SLEW * DT))
        a = omega[i] @ (arm.torque(q[i], 1e5 * np.eye(6)) - arm.torque(q[i], np.zeros(6))).T * t * 5
        b = 2.0 - omega[i] @ M @ omega[i] / 2 - t * omega[i] @ arm.torque(q[i], np.zeros(6))
        x, c, lo, hi = safe[i] / 5e5, command[i] / 5e5, lo / 5e5, hi / 5e5
        assert a @ x <= b + 1e-7
        assert unexplained(x, c - x, lo, hi, a[None], np.array([b])) < 1e-6
        checked += a @ np.clip(c, lo, hi) > b + 1e-6
    assert checked >= 3  # of those the row, not the box, moved


def test_one_joint_is_stopped_before_its_end_as_late_as_its_backup_allows():
    """n = 1: pressures that go to the rest at full slew stop the arm, integrated by SciPy, or the governor says so."""
    joint = report_joint(SAROSI_DMSP_20_400N)
    governor = PressureGovernor(joint, DT, SLEW, inertia=0.05)
    theta, P, rest = 0.3, np.array([2.5, 2.0]) * BAR, governor.made.rules.rest
    end = governor.mechanism.angle_limits[0][1]

    def turns_at(omega, P):
        """Return the farthest angle [rad] under a backup that does not brake."""

        def rate(t, x):
            u = P + np.clip(rest - P, -SLEW * t, SLEW * t)
            return [x[1], joint.torque(x[0], *u) / 0.05]

        return solve_ivp(rate, (0, 1.0), [theta, omega], rtol=1e-9, max_step=0.01).y[0].max()

    reached = {True: [], False: []}
    for omega in np.linspace(1.0, 25.0, 25):
        kept = governor.govern([theta], [omega], P, P + 0.1 * BAR).status != GovernorStatus.NOT_KEPT
        reached[kept].append(turns_at(omega, P))
    assert min(reached[False]) > end - np.deg2rad(1.0)  # refused is what hardly any brake would stop
    assert max(reached[True]) < end + np.deg2rad(3.0)  # the governor's brakes


@pytest.mark.slow
@pytest.mark.parametrize("name", ["joint", "arm26"])
def test_joints_never_leave_their_range_on_the_model(name):
    """Pushed to their ends with all force, at random, to and fro, and in time with their own motion; n = 1 and 2."""
    for commander in COMMANDERS:
        run = closed_loop(name, commander, arms=4, seconds=1.5)
        assert run.beyond <= 0
        assert run.broken == run.unable == 0
        assert run.moved > 0  # there was something to be done


OFF = {"strength": 0.1, "damping": 0.2, "mass": 0.1, "lag": 0.2}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["joint", "arm26"])
def test_joints_never_leave_their_range_on_any_plant_within_the_intervals(name):
    """Random plants, half of their numbers at an end of its interval; a governor that is told none of it loses them."""
    told = [closed_loop(name, commander, arms=2, seconds=1.0, off=OFF, told=True) for commander in COMMANDERS]
    assert max(run.beyond for run in told) <= 0
    assert sum(run.broken for run in told) == 0
    assert min(run.moved for run in told) < 0.2  # and it is not always the backup that acts
    untold = [closed_loop(name, commander, arms=6, seconds=1.0, off=OFF) for commander in ("bang", "resonance")]
    assert np.degrees(max(run.beyond for run in untold)) > 3


@pytest.mark.slow
def test_gas_in_the_muscles_takes_no_joint_beyond_the_range_if_the_governor_knows_it():
    worst = {"name": "arm26", "commander": "outward", "arms": 4, "seconds": 2.0, "lag": 0.1}
    assert closed_loop(**worst, gas="unknown").beyond > 0.5 * DEG
    known = closed_loop(**worst, gas="known")
    assert known.beyond < -0.4 * DEG
    assert known.broken == known.unable == 0


def test_a_rest_in_the_very_middle_of_the_range_is_found():
    """SciPy's root finder reports a failure if it begins at the solution."""
    law = Hogan1984(F_max=800.0, eps_max=0.28, P_max=6e5)
    arms = [(0.02, 0.0), (-0.02, 0.0), (0.0, 0.018), (0.0, -0.018), (0.015, 0.015)]
    limits = {"pressure_limits": (0.0, 6 * BAR), "min_contraction": 0.0, "angle_limits": ((-0.7, 0.7), (-0.9, 0.9))}
    arm = Mechanism(Pulleys(0.3, arms, 0.12), (law,) * 5, **limits)
    governor = PressureGovernor(arm, DT, 8 * BAR, inertia=(0.1, 0.05), lag=0.08)
    P, rest = np.full((1, 5), 3 * BAR), np.zeros((1, 2))
    assert np.isfinite(governor(rest, rest, P, P)).all()


def test_intervals_without_width_are_numbers():
    same = replace(
        GOVERNOR, lag=Interval(0.02, 0.02), damping=Interval(0.0, 0.0), strength=Interval.about(1.0, 0.0),
        inertia=Interval((0.12, 0.04), (0.12, 0.04)),
    )  # fmt: skip
    q, omega, P, rng = states(10, seed=4)
    command = rng.uniform(0, 5, P.shape) * BAR
    given, wanted = same.govern(q, omega, P, command), GOVERNOR.govern(q, omega, P, command)
    assert np.array_equal(given.P, wanted.P)
    assert np.array_equal(given.status, wanted.status)


def test_wider_intervals_let_less_through():
    """Wider intervals stop the joint at a lower speed; commands that pass all corners pass those within."""
    joint, P = report_joint(SAROSI_DMSP_20_400N), np.array([2.5, 2.0]) * BAR
    fastest = []
    for share in (0.0, 0.05, 0.1, 0.2):
        known = {"inertia": Interval.about(0.05, share), "strength": Interval.about(1.0, share)}
        governor = PressureGovernor(joint, DT, SLEW, damping=Interval.about(0.05, share), **known)
        passed = [
            omega
            for omega in np.linspace(1.0, 25.0, 25)
            if governor.govern([0.3], [omega], P, P + 0.1 * BAR).status == GovernorStatus.SAFE
        ]
        fastest.append(max(passed))
    assert fastest == sorted(fastest, reverse=True)
    assert 1.0 < fastest[-1] < fastest[0]


def test_the_energy_is_kept_by_the_heaviest_arm_with_the_strongest_muscles():
    """½ ωᵀM ω + t ω·τ(u) ≤ E for 200 arms within the intervals, at the pressures that were let through."""
    arm, t, rng = replace(ARM, angle_limits=None), 0.02 + DT, np.random.default_rng(6)
    heavy = np.array([0.13, 0.045])
    governor = PressureGovernor(
        arm, DT, SLEW, inertia=Interval((0.11, 0.035), heavy), lag=0.02, max_energy=2.0, strength=Interval(0.9, 1.1)
    )
    q, omega, P, _ = states(30, seed=6)
    omega *= np.sqrt(1.9 / (omega**2 @ heavy / 2))[:, None]
    safe, status = governor.govern(q, omega, P, P + rng.uniform(-0.15, 0.15, P.shape) * BAR)
    kept = np.flatnonzero(status <= GovernorStatus.MOVED)
    assert (status == GovernorStatus.MOVED).any()
    for i in kept:
        lever, forces = arm.arms(q[i]), arm.forces(q[i], safe[i])
        powers = (lever @ omega[i] if lever.shape[0] == 6 else lever.T @ omega[i]) * forces
        strengths = rng.uniform(0.9, 1.1, (200, 6))
        assert (omega[i] ** 2 @ heavy / 2 + t * strengths @ powers <= 2.0 + 1e-6).all()


def test_a_bound_on_the_energy_makes_fast_arms_brake():
    q, P = np.array([0.1, 0.1]), np.full(6, 2.5 * BAR)
    omega = np.array([4.0, 3.0])
    command = np.array([2.7, 2.3, 2.7, 2.3, 2.7, 2.3]) * BAR  # faster still
    free = PressureGovernor(ARM, DT, SLEW, inertia=(0.12, 0.04), max_energy=5.0)
    bound = PressureGovernor(ARM, DT, SLEW, inertia=(0.12, 0.04), max_energy=1.15)
    power = [float(omega @ ARM.torque(q, g(q, omega, P, command))) for g in (free, bound)]
    assert power[1] < power[0]


def test_batches_and_single_commands_agree_and_previous_is_where_the_slew_counts_from():
    q, omega, P, rng = states(6, seed=3)
    command = rng.uniform(0, 5, P.shape) * BAR
    many = GOVERNOR.govern(q, omega, P, command)
    for i in range(6):
        one = GOVERNOR.govern(q[i], omega[i], P[i], command[i])
        assert one.P == pytest.approx(many.P[i], abs=1e-6)
        assert one.status == many.status[i]
    last = np.clip(P + 0.5 * BAR, 0, 5 * BAR)
    assert within(q, GOVERNOR(q, omega, P, command, last), last).all()


def test_governors_can_be_sent_to_other_processes():
    q, omega, P, _ = states(1)
    GOVERNOR(q, omega, P, P)
    again = pickle.loads(pickle.dumps(GOVERNOR))
    assert np.array_equal(again(q, omega, P, P), GOVERNOR(q, omega, P, P))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"inertia": (0.1, 0.1, 0.1)}, "inertia has to be M"),
        ({"inertia": -1.0}, "inertia has to be M"),
        ({"inertia": ((0.1, 0.1), (0.1, 0.1))}, "inertia has to be M"),  # singular
        ({"slew": 5.0}, "slew = 5 Pa/s has to be at least 1000"),
        ({"load": -1.0}, "load has to be one number or n = 2"),
        ({"strength": 0.0}, r"strength has to be one number or m = 6, greater than 0 \[-\]"),
        ({"damping": Interval(0.2, 0.1)}, r"damping: the interval has to begin with its least value"),
        ({"lag": Interval(0.1, (0.1, 0.2))}, "lag has to be one number or m = 6"),
        ({"strength": Interval(0.2, 1.8)}, "for all that the intervals leave open"),
        ({"gravity": 9.81}, r"gravity = 9.81 has to be a function of q that gives n torques \[N·m\]"),
        ({"margin": 1.2}, "leaves a joint no range"),
        ({"max_energy": 0.0}, "max_energy = 0 J has to be positive"),
        ({"mechanism": "arm26"}, "expected a Mechanism or a joint"),
    ],
)
def test_governors_that_make_no_sense_are_refused(changed, said):
    given = {"mechanism": ARM, "dt": DT, "slew": SLEW, "inertia": (0.12, 0.04)} | changed
    with pytest.raises(InvalidInput, match=said):
        PressureGovernor(**given)


def test_states_that_are_none_are_refused():
    P = np.full(6, 2e5)
    with pytest.raises(InvalidInput, match="omega has to be finite"):
        GOVERNOR([0.1, 0.1], [np.nan, 0.0], P, P)
    with pytest.raises(InvalidInput, match=r"command has the shape \(5,\)"):
        GOVERNOR([0.1, 0.1], [0.0, 0.0], P, P[:5])
