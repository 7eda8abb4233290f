"""Stiffness of a mechanism against pushes, with the hysteresis of its joints."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import DEG, InvalidInput, Limits, Status, Stiffness, allocate
from allocator.allocation import allocate_at_least
from allocator.cli import app
from allocator.feasibility import feasible_targets
from allocator.joint import Loop, Slip
from allocator.machine_file import dumps
from allocator.mechanism import Endpoint, Mechanism, from_function, machines

ARM, A = machines.arm26(), 2 * DEG
DAHL = Loop(coulomb=0.4, presliding=1 * DEG)
SLIDING = Loop(Slip((3.0, 2.0), (1 * DEG, 5 * DEG), base=1.0, elastic=False))
LOOPS = DAHL, SLIDING
ADDED = np.array([0.4 * np.tanh(2.0) / A, 3.0 / 2 + 2.0])  # by hand, (S1) and (S2)
FELT = Stiffness(amplitude=A, loop=LOOPS)
HAND = Endpoint.planar([0.31, 0.34])
BOX = Limits(5.0)


def drawn(N, seed=0):
    """Return N postures, and torques and stiffnesses that are partly out of reach."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-0.8, 0.8, (N, 2))
    P = rng.uniform(*ARM.pressure_box(q, BOX), (N, ARM.m))
    return q, ARM.torque(q, P), ARM.stiffness(q, P) * rng.uniform(0.7, 1.3, (N, 1, 1))


@pytest.mark.parametrize("goals", [{}, {"priority": "stiffness"}, {"priority": "weighted", "weights": (1.0, 0.5)}])
def test_the_joints_hysteresis_takes_its_share_of_the_stiffness(goals):
    q, T, K = drawn(60)
    asked = {"joint": ARM, "limits": BOX} | goals
    felt, own = allocate(q, K + np.diag(ADDED), T, stiffness=FELT, **asked), allocate(q, K, T, **asked)
    np.testing.assert_allclose(felt.P, own.P, atol=1e-3)
    np.testing.assert_array_equal(felt.status, own.status)
    assert len(set(np.asarray(own.status).tolist())) > 1
    np.testing.assert_allclose(felt.K, ARM.stiffness(q, felt.P) + np.diag(ADDED), rtol=1e-12)


def test_the_stiffness_of_a_hand_has_it_too():
    q, *_ = drawn(30, seed=1)
    q[:, 1] = np.abs(q[:, 1]) + 0.1  # not stretched
    P = np.full((30, ARM.m), 3e5)
    lever = np.linalg.inv(np.stack([HAND.jacobian(one) for one in q]))
    asked = lever.swapaxes(1, 2) @ (ARM.stiffness(q, P) + np.diag(ADDED)) @ lever
    felt = allocate(q, asked, ARM.torque(q, P), joint=ARM, stiffness=replace(FELT, endpoint=HAND))
    assert felt.stiffness_met.all()
    np.testing.assert_allclose(felt.K_x, asked, rtol=1e-6)
    np.testing.assert_allclose(lever.swapaxes(1, 2) @ felt.K @ lever, asked, rtol=1e-6)
    np.testing.assert_allclose(felt.K - ARM.stiffness(q, felt.P), np.broadcast_to(np.diag(ADDED), felt.K.shape))


def test_a_posture_that_only_friction_holds_is_not_stable():
    """The arms of these muscles shrink with the angle, so that their forces push the joint away."""
    routes = from_function(0.4, 1, lambda q: [0.37 - s * 0.01 * q[0] - 0.1 * q[0] ** 2 for s in (1, -1)])
    toggle = Mechanism(routes, ARM.muscles[0])
    own = toggle.stiffness([0.0], [3e5, 3e5])[0, 0]
    assert own < 0
    stuck = Stiffness(amplitude=A, loop=Loop(coulomb=-2 * own * A / np.tanh(2.0), presliding=1 * DEG))
    a = allocate([0.0], [-own], [0.0], joint=toggle, stiffness=stuck)
    assert a.stiffness_met
    assert a.K[0, 0] == pytest.approx(-own)
    assert not a.holds
    assert a.status == Status.UNSTABLE


def test_at_least_counts_it_and_its_margin_does_not():
    q, floor = np.array([0.3, 0.6]), np.diag([14.0, 9.0])
    felt = allocate_at_least(ARM, q, floor, [1.0, -1.0], stiffness=FELT, margin=2.0)
    own = allocate_at_least(ARM, q, floor - np.diag(ADDED), [1.0, -1.0], margin=2.0)
    np.testing.assert_allclose(felt.P, own.P, atol=50.0)
    assert np.linalg.eigvalsh(felt.K - np.diag(ADDED))[0] > 2.0 - 1e-6


def test_feasible_targets_are_shifted_by_it():
    q = np.array([0.3, 0.6])
    low, high = feasible_targets(ARM, q, stiffness=FELT).interval("K11")
    assert (low, high) == pytest.approx(np.array(feasible_targets(ARM, q).interval("K11")) + ADDED[0])


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (Stiffness(amplitude=A), "a mechanism has no hysteresis of its own; give loop with the amplitude"),
        (Stiffness(amplitude=A, loop=(DAHL,) * 3), "3 loops of hysteresis for n = 2 joints"),
        (Stiffness(amplitude=A, loop=Loop(mu=0.1)), "must not depend on the pressures"),
        (Stiffness(amplitude=A, loop=Loop(Slip((3.0,), (A,), 0.5, elastic=False))), "must not depend on the pressures"),
        (Stiffness(amplitude=A, loop=(DAHL, 0.4)), "has to be a Loop"),
        (Stiffness(loop=DAHL), "goes with the amplitude"),
        (Stiffness(amplitude=2.0, loop=DAHL), "for degrees multiply"),
    ],
)
def test_a_push_that_cannot_be_is_refused_in_a_sentence(kind, said):
    with pytest.raises(InvalidInput, match=said):
        allocate([0.3, 0.6], [14.0, 9.0], [0.0, 0.0], joint=ARM, stiffness=kind)


def test_one_joint_has_one_loop():
    one, row = (allocate(0.0, 15.0, 0.0, stiffness=replace(FELT, loop=loop)) for loop in (DAHL, [DAHL]))
    assert one.P1 == row.P1
    with pytest.raises(InvalidInput, match="one loop of hysteresis, not 2"):
        allocate(0.0, 5.0, 0.0, stiffness=FELT)


def test_the_command_takes_the_friction_of_the_file(tmp_path):
    path = tmp_path / "arm.toml"
    path.write_text(dumps(ARM) + "\n[friction]\ncoulomb = [0.4, 0.2]\npresliding = 0.0174532925\n", encoding="utf-8")
    asked = "--posture", "17,34", "--stiffness", "24,14", "--amplitude", "2", "--json"
    done = CliRunner().invoke(app, ["allocate", "--machine", str(path), *asked])
    assert done.exit_code == 0, done.output
    added = np.array([0.4, 0.2]) * np.tanh(2.0) / A
    wanted = allocate(np.array([17, 34]) * DEG, np.array([24.0, 14.0]) - added, [0.0, 0.0], joint=ARM)
    assert json.loads(done.stdout)["P_bar"] == pytest.approx(wanted.P / 1e5, rel=1e-6)
    bare = CliRunner().invoke(app, ["allocate", "--machine", "arm26", *asked])
    assert "the machine has no table [friction]" in str(bare.exception)
