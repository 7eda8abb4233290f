"""On a lever several pairs may give the same, and the torques at a stiffness be several intervals: all of them."""

import numpy as np
import pytest

from allocator import BAR, InvalidInput, Limits, allocate, feasibility_map, stiffness_interval
from allocator.feasibility import torque_intervals
from tests.exact_everywhere.joints import joint_of

pytestmark = pytest.mark.filterwarnings("ignore::allocator.joint.assumption.Extrapolated")  # of fits, at 0 bar
SEVERAL = [("Tondu2021", "lever-A"), ("Andrikopoulos2016", "lever-B"), ("Tondu2021-report", "lever-B")]


def box_of(joint, theta):
    return joint.pressure_box(theta, Limits(min_force=0.0))


def image(joint, theta, n):
    """(T, K) on an n × n grid of the box at one angle."""
    box = box_of(joint, theta)
    P1, P2 = (
        np.linspace(box.agonist.lo, box.agonist.hi, n)[:, None],
        np.linspace(box.antagonist.lo, box.antagonist.hi, n),
    )
    return joint.torque(theta, P1, P2), joint.stiffness(theta, P1, P2)


def on_level(values, level, other):
    """`other` where `values` cross `level`, by linear interpolation along rows and columns of a grid."""
    found = []
    for v, y in ((values, other), (values.T, other.T)):
        d = v - level
        i, j = np.nonzero(d[:, :-1] * d[:, 1:] < 0)
        share = d[i, j] / (d[i, j] - d[i, j + 1])
        found.append(y[i, j] * (1 - share) + y[i, j + 1] * share)
    return np.sort(np.concatenate(found))


@pytest.mark.parametrize(("muscle", "geometry"), SEVERAL)
def test_the_torques_at_a_stiffness_are_those_of_a_grid(muscle, geometry):
    joint, rng = joint_of(muscle, geometry), np.random.default_rng(0)
    most = 0
    for theta in rng.uniform(*joint.angle_range, 12):
        T, K = image(joint, theta, 401)
        level = rng.uniform(K.min(), K.max())
        low, high = torque_intervals(theta, level, joint=joint)
        crossed, near = on_level(K, level, T), 1e-2 * np.ptp(T)
        inside = ((crossed[:, None] >= low - near / 10) & (crossed[:, None] <= high + near / 10)).any(axis=1)
        assert inside.all()
        assert [low[0], high[-1]] == pytest.approx([crossed[0], crossed[-1]], abs=near)
        most = max(most, len(low))
    assert most > 1 or muscle != "Andrikopoulos2016"


@pytest.mark.parametrize(("muscle", "geometry"), SEVERAL)
def test_the_stiffnesses_at_a_torque_are_those_of_a_grid(muscle, geometry):
    joint, rng = joint_of(muscle, geometry), np.random.default_rng(1)
    for theta in rng.uniform(*joint.angle_range, 12):
        T, K = image(joint, theta, 401)
        level = rng.uniform(T.min(), T.max())
        crossed = on_level(T, level, K)
        K_min, K_max = stiffness_interval(theta, level, joint=joint)
        assert K_min <= crossed[0] + 1e-6 * K.max()
        assert K_max >= crossed[-1] - 1e-6 * K.max()
        assert [K_min, K_max] == pytest.approx([crossed[0], crossed[-1]], abs=1e-2 * np.ptp(K))


FOLDED = [("Tondu2021", "lever-A", 0.1), ("Andrikopoulos2016", "lever-B", -0.2)]


@pytest.mark.slow
@pytest.mark.parametrize(("muscle", "geometry", "theta"), FOLDED)
def test_the_edges_at_an_angle_enclose_all_of_a_grid_and_nothing_else(muscle, geometry, theta):
    joint = joint_of(muscle, geometry)
    T, K = image(joint, theta, 201)
    outline = feasibility_map(theta, None, None, joint=joint).edges
    torques = np.linspace(T.min(), T.max(), 60)[1:-1]
    met = np.array([np.interp(torques, edge.T, edge.K, left=np.nan, right=np.nan) for edge in outline])
    least, most = np.nanmin(met, axis=0), np.nanmax(met, axis=0)
    near = 5e-3 * np.ptp(K)
    for level, low, high in zip(torques, least, most, strict=True):
        crossed = on_level(T, level, K)
        assert [low, high] == pytest.approx([crossed[0], crossed[-1]], abs=near)
    assert () in {edge.active for edge in outline}  # a fold: the border of the box alone does not enclose it


def test_a_stiffness_or_an_angle_out_of_reach_has_no_torques():
    low, high = torque_intervals(np.array([0.0, 3.0]), 1e4)
    assert low.shape == high.shape == (0, 2)
    low, _ = torque_intervals(np.array([0.0, 3.0]), 8.0)
    assert np.isnan(low[0]).tolist() == [False, True]


def smooth_paths(joint, seed, n=120):
    """Angles and pressures that change smoothly and stay in the box."""
    rng, s = np.random.default_rng(seed), np.linspace(0, 1, n)

    def share():
        a, b, c = rng.uniform(-1, 1, 3)
        return 0.5 + 0.45 * np.tanh(a + 1.5 * b * np.sin(3 * s + c) + c * s)

    left, right = joint.angle_range
    theta = left + (right - left) * share()
    box = box_of(joint, theta)
    return theta, *(side.lo + share() * (side.hi - side.lo) for side in box)


def squared_steps(P1, P2):
    return (np.diff(P1) ** 2 + np.diff(P2) ** 2).sum()


@pytest.mark.slow
@pytest.mark.parametrize(("muscle", "geometry"), SEVERAL)
def test_a_planned_trajectory_steps_no_more_than_the_pressures_it_was_made_of(muscle, geometry):
    joint, jumped = joint_of(muscle, geometry), 0
    for seed in range(6):
        theta, P1, P2 = smooth_paths(joint, seed)
        T, K = joint.torque(theta, P1, P2), joint.stiffness(theta, P1, P2)
        alone, planned = (allocate(theta, K, T, joint=joint, along=along) for along in (None, 0))
        assert planned.success.all()
        assert np.abs(planned.T_error).max() < 1e-8
        assert np.abs(planned.K_error).max() < 1e-8
        assert squared_steps(planned.P1, planned.P2) <= squared_steps(P1, P2) * (1 + 1e-6)
        assert squared_steps(planned.P1, planned.P2) <= squared_steps(alone.P1, alone.P2) * (1 + 1e-9)
        jumped += squared_steps(alone.P1, alone.P2) > 2 * squared_steps(P1, P2)
    assert jumped  # else there would be nothing to plan


def test_the_least_pair_is_answered_or_the_nearest_to_previous():
    joint = joint_of("Tondu2021", "lever-A")
    theta, P1, P2 = smooth_paths(joint, 3)
    T, K = joint.torque(theta, P1, P2), joint.stiffness(theta, P1, P2)
    least = allocate(theta, K, T, joint=joint)
    several = least.pairs > 1
    assert several.any()
    assert (least.P1 + least.P2 <= (P1 + P2) * (1 + 1e-9)).all()
    nearest = allocate(theta, K, T, joint=joint, limits=Limits(previous=(P1, P2), max_step=5 * BAR))
    assert nearest.P1 == pytest.approx(P1, abs=2.0)
    assert nearest.P2 == pytest.approx(P2, abs=2.0)


def test_along_is_an_axis_of_the_targets():
    joint = joint_of("Tondu2021", "lever-A")
    theta, P1, P2 = smooth_paths(joint, 3, n=40)
    T, K = joint.torque(theta, P1, P2), joint.stiffness(theta, P1, P2)
    row = allocate(theta, K, T, joint=joint, along=0)
    both = allocate(*(np.stack([x, x], 1) for x in (theta, K, T)), joint=joint, along=-2)
    assert (both.P1 == row.P1[:, None]).all()
    for wrong in (1, -2, 0.5, True):
        with pytest.raises(InvalidInput, match="no axis"):
            allocate(theta, K, T, joint=joint, along=wrong)
    with pytest.raises(InvalidInput, match="along plans"):
        allocate(theta, K, T, joint=joint, along=0, method="qp")


def test_a_gap_says_how_far_an_optimiser_is_from_the_proved_bound():
    joint, target = joint_of("Tondu2021", "lever-A"), (-0.0015, 78.7957, 0.7181)
    assert allocate(*target, joint=joint).gap == 0
    stuck = allocate(*target, joint=joint, method="qp")
    missed = abs(stuck.K_error) / allocate(*target, joint=joint)._problem.scales[1][0]
    assert stuck.gap == pytest.approx(missed, rel=1e-6)
    assert np.isnan(allocate(*target, joint=joint, method="analytic").gap)
    assert allocate(0.1, 9.0, 1.0).gap == 0


def test_a_missed_torque_is_told_with_the_intervals_at_the_stiffness():
    joint = joint_of("Andrikopoulos2016", "table")
    a = allocate(0.437976296377911, 30.346504081749746, -31.995028370875847, joint=joint, priority="stiffness")
    assert " N·m/rad is " in a.message
    low, high = a.torque_intervals.T
    assert ((low - 1e-9 <= a.T) & (a.T <= high + 1e-9)).sum() == 1
