"""The rests of a run say whether the ratio of the muscles' strengths has moved; and what pushes meet along it."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import DEG, InvalidInput, PrandtlIshlinskii
from mpc import RealPlant, simulate
from mpc.bench.measuring.due import check_due, imbalance
from mpc.tracking.cost import CALM
from mpc.trials.loops import Settings, loop
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import Run

NOMINAL = RealPlant.standard().nominal
LOOPS = PrandtlIshlinskii((0.4, 0.3, 0.3), (4 * DEG, 10 * DEG), base=0.2)
RESTS = (-20, 5.0), (10, 6.0), (25, 5.0)  # [°], [N·m/rad]


def rests(g, load=0.0, hysteresis=None):
    """A run that rests thrice, two seconds each, with the disturbance that muscles g times as strong make."""
    plant = replace(NOMINAL, joint=replace(NOMINAL.joint, hysteresis=hysteresis))
    rows, n = [], 200
    for angle, K in RESTS:
        x = plant.at_rest(angle * DEG, K)
        T = [float(s.torque(P)) for s, P in zip(plant.joint.sides(x[0]), x[2:], strict=True)]
        rows += [[*x, (g[0] - 1) * T[0] + (g[1] - 1) * T[1] + load]] * n
    estimate = np.array(rows)
    x, M = np.vstack([estimate[:, :4], estimate[-1:, :4]]), len(estimate)
    K, forces = plant.along(x)
    each = np.zeros(M)
    whole = np.zeros(M, np.int64)
    return Run(
        plant, 0.01, 0.01 * np.arange(M + 1), x, estimate, x[:-1, 2:], x[:, 0], np.round(K, 9), K, forces, each, whole,
        whole, each, each, np.zeros((M, 3)), "",
    )  # fmt: skip


def test_the_ratio_of_the_strengths_shows_at_rest_and_their_common_factor_does_not():
    for g in ((1.0, 1.0), (1.06, 0.98), (0.9, 1.1), (1.1, 1.1)):
        found = imbalance(rests(g))
        assert found.rests == 3
        assert found.ratio == pytest.approx(g[0] - g[1], rel=1e-6, abs=1e-9)
        assert found.std == pytest.approx(0.01, rel=1e-3)  # no friction: sensors' offsets alone
    assert "14 ± 1 %, so that the agonist" in check_due(rests((1.1, 0.96)))
    assert check_due(rests((1.02, 0.99))) == check_due(rests((1.2, 1.2))) == ""


def test_friction_makes_the_hint_careful():
    careful = imbalance(rests((1.06, 1.0), hysteresis=LOOPS))
    assert careful.std > 0.02
    assert check_due(rests((1.045, 1.0))) != ""
    assert check_due(rests((1.045, 1.0), hysteresis=LOOPS)) == ""


def test_a_run_without_rests_or_an_estimate_gives_no_hint():
    run = rests((1.1, 0.9))
    moving = replace(run, theta_ref=np.linspace(0, 1, run.t.size))
    assert imbalance(moving) is None
    assert check_due(replace(run, estimate=np.full_like(run.estimate, np.nan))) == ""
    assert check_due(replace(run, estimate=run.estimate[:, :4])) == ""


def test_pushes_meet_along_a_run_what_the_joint_says_of_its_states():
    run = rests((1.0, 1.0), hysteresis=LOOPS)
    said = run.plant.joint.stiffness(run.x[:, 0], run.x[:, 2], run.x[:, 3], amplitude=2 * DEG)
    np.testing.assert_allclose(run.felt(2 * DEG), said, rtol=1e-12)
    with pytest.raises(InvalidInput, match="an arm has no hysteresis"):
        replace(run, plant=None).felt(2 * DEG)


@pytest.mark.slow
@pytest.mark.compiles
@pytest.mark.parametrize(("gains", "word"), [((1.1, 0.95), "the agonist"), ((1.1, 1.1), "")])
def test_an_observer_s_run_on_drifted_muscles_says_so(gains, word):
    real = RealPlant.standard(gains)
    t = np.array([0, 2, 3, 5, 6, 8.0])
    reference = Reference(t, np.array([-15, -15, 15, 15, 0, 0.0]) * DEG, np.full(6, 5.5))
    controller, observer = loop("mpc", Settings(real.nominal, compensation=real.known(share=1.0), weights=CALM))
    said = check_due(simulate(real, controller, reference, observer=observer), real.friction.loop)
    assert (word in said) if word else said == ""


def test_a_load_is_named_beside_the_strengths():
    said = check_due(rests((1.0, 1.0), load=0.5))
    assert "or a load of +0.5 N·m acts" in said
