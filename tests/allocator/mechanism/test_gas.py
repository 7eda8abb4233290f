"""Trapped gas in a mechanism: a worked example, the one joint, the polytropic law, files and mistakes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from allocator import AntagonistJoint, Gas, InvalidInput, Lever, Status, Stiffness, allocate, load_machine
from allocator import save_machine as save
from allocator.mechanism import Mechanism, Pulleys, machines
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N
from allocator.units import BAR
from tests.conftest import PULLEY

ROOM = Gas(kappa=1.3, atmosphere=1.013e5)
FILLED = replace(SAROSI_DMSP_20_400N, inner_radius=0.01, tube_volume=20e-6)
ARM = replace(machines.arm26().with_muscles(FILLED), gas=ROOM)
Q, P = np.array([0.4, -0.3]), np.array([3, 2, 2.5, 3.5, 4, 1.5]) * BAR
ASKED = {
    "shut": {"valves": "shut"},
    "one": {"valves": (False, True)},
    "2 Hz": {"frequency": 2.0, "lag": (0.1, 0.05)},
}


def printed(value, digits):
    return pytest.approx(value, abs=0.51 * 10.0**-digits, rel=0)


def test_the_worked_example():
    assert FILLED.volume_at_rest(0.4) * 1e6 == printed(145.664, 3)
    volumes = [muscle.volume(P[j]) * 1e6 for j, muscle in enumerate(ARM.at(Q))]
    assert volumes == printed([289.531, 261.581, 265.399, 286.361, 282.269, 270.041], 3)
    K = ARM.stiffness(Q, P, valves="shut")
    assert [*K[0], *K[1]] == printed([18.346671, 7.110218, 7.110218, 15.677877], 6)


@pytest.mark.parametrize("muscle", [FILLED, TONDU_DMSP_20_400N], ids=["affine", "not affine"])
def test_shut_stiffness_is_that_of_the_polytropic_law(muscle):
    """(P + p_a) V^κ is solved for every pressure, and the torque differentiated by the posture."""
    shut = np.array([True, False, True, True, False, True])
    arm = ARM.with_muscles(muscle)

    def trapped(q):
        now = P.copy()
        for j, (before, after) in enumerate(zip(arm.at(Q), arm.at(q), strict=True)):
            filled = (P[j] + ROOM.atmosphere) * before.volume(P[j]) ** ROOM.kappa
            for _ in range(60):
                now[j] = filled / after.volume(now[j]) ** ROOM.kappa - ROOM.atmosphere
        return arm.torque(q, np.where(shut, now, P))

    h, steps = 1e-4, np.eye(2)
    K = -np.stack([(trapped(Q + h * e) - trapped(Q - h * e)) / (2 * h) for e in steps], axis=-1)
    assert arm.stiffness(Q, P, valves=tuple(shut.tolist())) == pytest.approx(K, rel=2e-6)


def test_a_frequency_lies_between_open_and_shut():
    lag = [0.1, 0.2, 0.1, 0.2, 0.1, 0.2]
    K = [ARM.stiffness(Q, P, frequency=f, lag=lag) for f in (0.0, 0.5, 5.0, 1e6)]
    assert K[0] == pytest.approx(ARM.stiffness(Q, P))
    assert K[-1] == pytest.approx(ARM.stiffness(Q, P, valves="shut"))
    assert all(np.linalg.eigvalsh(b - a)[0] > 0 for a, b in pairwise(K))


@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED)
@pytest.mark.parametrize("lever", [False, True])
def test_one_joint_has_the_pressures_of_allocate(lever, asked):
    geometry = Lever(0.25, 0.1655, 0.05094, 0.051) if lever else PULLEY
    limits = (-0.45, 0.45) if lever else None
    joint = AntagonistJoint(geometry, FILLED, replace(FILLED, tube_volume=60e-6), angle_limits=limits, gas=ROOM)
    rng, one = np.random.default_rng(4), Mechanism.from_joint(joint)
    theta = rng.uniform(*joint.angle_range, 40)
    P1, P2 = rng.uniform(1.0, 5.0, (2, 40)) * BAR
    felt = one.stiffness(theta[:, None], np.stack([P1, P2], axis=-1), **asked)[:, 0, 0]
    if "valves" in asked:
        assert felt == pytest.approx(joint.stiffness(theta, P1, P2, **asked))
    else:
        assert felt == pytest.approx(joint.dynamic_stiffness(theta, P1, P2, **asked).real)
    K, T = np.abs(felt) * rng.choice([1.0, 2.0], 40), joint.torque(theta, P1, P2) * rng.choice([1.0, 3.0], 40)
    a = allocate(theta, K, T, joint=joint, stiffness=Stiffness(**asked))
    b = allocate(theta[:, None], K[:, None], T[:, None], joint=one, stiffness=Stiffness(**asked))
    assert b.P == pytest.approx(np.stack([a.P1, a.P2], axis=-1), abs=1e-9 * 5 * BAR)
    assert np.array_equal(b.status[b.holds], a.status[b.holds])
    assert b.isobaric_stiffness[:, 0, 0] == pytest.approx(a.isobaric_stiffness, abs=1e-9)


def test_shut_valves_give_what_open_ones_cannot():
    K, T = ARM.stiffness(Q, P, valves="shut"), ARM.torque(Q, P)
    assert allocate(Q, K, T, joint=ARM).status == Status.STIFFNESS_LIMITED
    a = allocate(Q, K, T, joint=ARM, stiffness=Stiffness("shut"))
    assert a.success
    assert a.K == pytest.approx(K, rel=1e-9)
    assert ARM.stiffness(Q, a.P, valves="shut") == pytest.approx(K, rel=1e-9)
    assert a.isobaric_stiffness == pytest.approx(ARM.stiffness(Q, a.P))
    assert "shut stiffness" in repr(a)
    assert "isobaric_stiffness_Nm_per_rad" in a.to_dict()
    assert "isobaric_stiffness_Nm_per_rad" not in allocate(Q, K, T, joint=ARM).to_dict()


def test_a_file_keeps_the_gas(tmp_path):
    save(ARM, tmp_path / "arm.toml")
    assert load_machine(tmp_path / "arm.toml").gas == ROOM
    save(replace(ARM, gas=Gas()), tmp_path / "arm.toml")
    assert "[gas]" not in (tmp_path / "arm.toml").read_text()
    assert Mechanism.from_joint(AntagonistJoint(PULLEY, FILLED, FILLED, gas=ROOM)).gas == ROOM


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: ARM.stiffness(Q, P, valves="free"), "valves = 'free' is unknown; choose 'open', 'shut', or m = 6"),
        (lambda: ARM.stiffness(Q, P, valves=(True, False)), r"valves = \(True, False\) is unknown; .* m = 6 truth val"),
        (lambda: ARM.stiffness(Q, P, frequency=2.0), "go together"),
        (lambda: ARM.stiffness(Q, P, frequency=2.0, lag=[0.1, 0.2]), "one time constant or m = 6 of them"),
        (lambda: ARM.stiffness(Q, P, valves="shut", frequency=2.0, lag=0.1), "exclude each other"),
        (
            lambda: allocate(
                Q, 9.0, 1.0, joint=ARM.with_muscles(replace(FILLED, inner_radius=None)), stiffness=Stiffness("shut")
            ),
            r"Sarosi2012 holds is not known.* inner_radius \[m\]",
        ),
        (lambda: replace(ARM, gas=1.3), "gas = 1.3 has to be a Gas"),
        (
            lambda: Mechanism(
                Pulleys(0.4, [(0.02,), (-0.02,)], 0.1375), replace(FILLED, rest_volume=1e-8, tube_volume=0.0)
            ).stiffness([0.0], [2e5, 2e5], valves="shut"),
            "the gas of the muscle 1 would grow .* if rest_volume was meant in litres",
        ),
        (
            lambda: Mechanism(Pulleys(0.1, [(0.05,), (-0.05,)], 0.1375), replace(FILLED, tube_volume=0.0)).stiffness(
                [0.6], [2e5, 2e5], valves="shut"
            ),
            r"the gas of the muscle 2 has no volume \(-2.41e-06 m³\) at the contraction ratio -0.1625: narrow",
        ),
    ],
)
def test_mistakes_are_one_sentence(call, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        call()
