"""What binds is named, and what is broken is named and has its status, on every road: pressures and forces judge."""

import numpy as np
import pytest

from allocator import AntagonistJoint, Lever, Limits, Pulley, Status, allocate, report_joint
from allocator.allocation.two_muscles.kernels import calls
from allocator.muscles import Hogan1984, TonduLopez2000
from allocator.muscles.catalogue import SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG

PULLEY = Pulley(rest_length=0.40, radius=0.02, initial_contraction=0.1375)
LEVER = Lever(rest_length=0.40, anchor=0.30, lever=0.03, offset=0.0435)
SAROSI, VALID = SAROSI_DMSP_20_400N, Hogan1984(1500.0, 0.30, 4 * BAR)
LOPEZ = TonduLopez2000(0.0109, 25.5 * DEG, 1.4, 2.0, 1.2 * BAR)
STOPS = (-80 * DEG, 80 * DEG)
JOINTS = {
    "tondu": report_joint(),
    "affine, unequal, lever": AntagonistJoint(LEVER, SAROSI, SAROSI_DMSP_20_200N, angle_limits=STOPS),
    "supply from 2 bar": AntagonistJoint(PULLEY, SAROSI, SAROSI, (2 * BAR, 5 * BAR), angle_limits=STOPS),
    "model valid to 4 bar": AntagonistJoint(PULLEY, VALID, VALID, angle_limits=STOPS),
    "no closed form": AntagonistJoint(PULLEY, LOPEZ, LOPEZ, angle_limits=STOPS),
}
FORCES = [(0.0, None), (None, None), (40.0, 400.0), (2000.0, None), (0.0, 150.0)]
SLEWS = [None, 0.05 * BAR, 1.5 * BAR]
CLOSE = 1e-6  # of the supply range, or of 1000 N
CONTRADICTED = (Status.CONFLICT, Status.SLACK, Status.OUTSIDE_LIMITS)


def named_by(joint, a, i, low, high, previous, max_step):
    """What of muscle i (0, 1) binds, what is broken, and which status that is, from pressure and force alone."""
    P, F, near = (a.P1, a.P2)[i], a.forces[i], CLOSE * joint.pressure_span
    muscle, validity = ("agonist", "antagonist")[i], (joint.agonist, joint.antagonist)[i].max_pressure
    supply = joint.pressure_limits
    top = f"P{i + 1} upper" if validity >= supply[1] else f"{muscle} model validity"
    room = {f"P{i + 1} lower": (P - supply[0]) / near, top: (min(supply[1], validity) - P) / near}
    if low is not None:
        room[f"{muscle} slack"] = (F - low) / (1e3 * CLOSE)
    if high is not None:
        room[f"{muscle} force ceiling"] = (high - F) / (1e3 * CLOSE)
    if previous is not None:
        room[f"P{i + 1} rate"] = (max_step - abs(P - previous[i])) / near
    broken = {name for name, left in room.items() if left < -1}
    status = Status.SLACK if f"{muscle} slack" in broken else Status.EXACT
    if others := broken - {f"{muscle} slack"}:
        contradicted = others == {f"{muscle} force ceiling"} and abs(P - supply[0]) < near
        status = max(status, Status.CONFLICT) if contradicted else Status.OUTSIDE_LIMITS
    return {name for name, left in room.items() if abs(left) <= 1}, broken, status


def questions(joint, n, seed):
    """Targets across what there is, and pressures from which a step is made, inside the supply and beyond it."""
    rng = np.random.default_rng(seed)
    theta = 0.9 * rng.uniform(*joint.angle_range, n)
    P1, P2 = rng.uniform(*joint.pressure_limits, (2, n))
    K, T = np.maximum(joint.stiffness(theta, P1, P2), 0.1), joint.torque(theta, P1, P2)
    return theta, K * rng.uniform(0.8, 1.3, n), T + rng.normal(0, 2, n), rng.uniform(0, 7 * BAR, (2, n))


@pytest.mark.slow
@pytest.mark.parametrize("priority", ["torque", "stiffness"])
@pytest.mark.parametrize("joint", JOINTS.values(), ids=JOINTS.keys())
def test_what_binds_and_what_is_broken_is_named_and_has_its_status(joint, priority, monkeypatch):
    seen = set()
    for case, (forces, max_step) in enumerate((forces, step) for forces in FORCES for step in SLEWS):
        theta, K, T, (P1, P2) = questions(joint, 12, seed=case)
        limits, asked = Limits(*forces), {"priority": priority, "joint": joint}
        slew = limits if max_step is None else limits._replace(previous=(P1, P2), max_step=np.full(12, max_step))
        batches = []
        for pays in (calls._PAYS, 1):  # the readable implementation, the compiled one
            monkeypatch.setattr(calls, "_PAYS", pays)
            batches.append(allocate(theta, K, T, limits=slew, **asked))
        for i in range(12):
            previous = None if max_step is None else (P1[i].item(), P2[i].item())
            one = limits if max_step is None else limits._replace(previous=previous, max_step=max_step)
            a = allocate(theta[i].item(), K[i].item(), T[i].item(), limits=one, **asked)
            found = [named_by(joint, a, muscle, *forces, previous, max_step) for muscle in (0, 1)]
            binds, broken, statuses = zip(*found, strict=True)
            assert set(a.active) == set.union(*binds)
            assert set(a.broken) == set.union(*broken)
            assert a.status == max(statuses) if any(statuses) else a.status <= Status.BOTH_LIMITED
            assert all(name in a.message for name in a.broken)
            assert {(b.active[i], b.broken[i], b.status[i]) for b in batches} == {(a.active, a.broken, a.status)}
            seen.add(a.status)
    assert {Status.SLACK, Status.OUTSIDE_LIMITS} <= seen
    assert Status.CONFLICT in seen or joint.pressure_limits[0] == 0


@pytest.mark.parametrize("method", ["qp", "nlp", "convex"])
def test_optimisers_say_the_same_of_what_no_step_can_keep(method):
    for previous in ((7 * BAR, 2 * BAR), (0.2 * BAR, 2 * BAR), (4 * BAR, 4 * BAR)):
        options = {"limits": Limits(previous=previous, max_step=0.1 * BAR, max_force=500.0)}
        exact, other = (allocate(0.3, 7.5, 1.0, method=m, **options) for m in ("exact", method))
        assert (other.status, other.active, other.broken) == (exact.status, exact.active, exact.broken)
        assert exact.status in CONTRADICTED


def test_of_limits_that_lie_at_one_pressure_all_bind():
    """A step of 1 bar ends where the supply does, whichever way it is rounded: relieving one alone does not help."""
    for previous in (4 * BAR, 4 * BAR + 1e-9, 4 * BAR - 1e-9):
        a = allocate(0.3, 17.0, 1.0, limits=Limits(previous=(previous, previous), max_step=1 * BAR))
        assert {"P1 rate", "P1 upper"} <= set(a.active)
        assert not a.broken


def test_the_least_force_that_the_supply_s_lower_end_gives_binds_with_it():
    joint = JOINTS["supply from 2 bar"]
    F1, _ = joint.forces(0.1, *2 * [joint.pressure_limits[0]])
    a = allocate(0.1, 0.1, -50.0, joint=joint, limits=Limits(min_force=float(F1)))
    assert {"P1 lower", "agonist slack"} <= set(a.active)
    assert a.status is Status.BOTH_LIMITED


def test_a_floor_that_the_upper_limits_do_not_reach_is_not_blamed_on_the_lower_ones():
    a = allocate(0.3, 7.5, 1.0, limits=Limits(min_cocontraction=4.9 * BAR, max_force=300.0))
    assert a.status is Status.CONFLICT
    assert a.broken == ("co-contraction floor",)
    assert set(a.active) == {"agonist force ceiling", "antagonist force ceiling", "co-contraction floor"}


@pytest.mark.parametrize("road", [float, lambda x: np.full(2, x)], ids=["scalar", "array"])
@pytest.mark.parametrize("pays", [1, 10**9], ids=["compiled", "readable"])
def test_no_target_is_so_far_away_that_a_slack_cable_passes_for_taut(road, pays, monkeypatch):
    monkeypatch.setattr(calls, "_PAYS", pays)
    for T in (1.0, 1e6, 1e12, -1e12, 1e300):
        a = allocate(road(0.3), 7.5, T, limits=Limits(previous=(0.5 * BAR, 0.5 * BAR), max_step=0.1 * BAR))
        assert np.unique(a.status).tolist() == [Status.SLACK]


@pytest.mark.parametrize("tiny", [0.1, 0.5, 5.0, 20.0])
@pytest.mark.parametrize("joint", [JOINTS["tondu"], JOINTS["affine, unequal, lever"]], ids=["tondu", "affine"])
def test_the_library_takes_its_own_answers_though_one_muscle_is_all_but_vented(joint, tiny):
    """Only where both pressures are that small can they be meant in bar."""
    for P in ((tiny, 3 * BAR), (3 * BAR, tiny)):
        T, K = joint.torque(0.1, *P), joint.stiffness(0.1, *P)
        for road in (float, lambda x: np.full(2, x)):
            a = allocate(road(0.1), float(K), float(T), joint=joint, limits=Limits(min_force=None))
            assert np.array(a.P1) == pytest.approx(P[0], abs=1e-2)
            found = a.P1, a.P2
            assert joint.torque(0.1, *found) == pytest.approx(T, rel=1e-7)
            assert joint.forces(0.1, *found)[0] == pytest.approx(joint.forces(0.1, *P)[0], rel=1e-6)
            assert np.isfinite(joint.jacobian(0.1, *found)).all()
            assert joint.equilibrium(*found, T) == pytest.approx(0.1, abs=1e-6)
            stay = allocate(
                road(0.1), float(K), float(T), joint=joint, limits=Limits(min_force=None, previous=found, max_step=BAR)
            )
            assert np.array(stay.P2) == pytest.approx(P[1], abs=1e-2)


@pytest.mark.parametrize("name", ["tondu", "affine, unequal, lever", "no closed form"])
@pytest.mark.parametrize("shape", [(2, 3), (6, 1)])
def test_a_table_of_targets_keeps_the_slew_limit_of_each(name, shape):
    joint = JOINTS[name]
    theta, K, T, now = questions(joint, 6, seed=3)
    row, table = (
        allocate(*targets, joint=joint, limits=Limits(previous=tuple(P), max_step=0.3 * BAR))
        for targets, P in (((theta, K, T), now), ((x.reshape(shape) for x in (theta, K, T)), now.reshape(2, *shape)))
    )
    for found in ("P", "forces", "status", "gap", "kkt_residual", "pairs", "isobaric_stiffness"):
        np.testing.assert_array_equal(np.ravel(getattr(table, found)), np.ravel(getattr(row, found)))
    np.testing.assert_array_equal(np.ravel(table.jacobian()), np.ravel(row.jacobian()))
    assert table.active.ravel().tolist() == row.active.tolist()
    assert table.message == row.message
