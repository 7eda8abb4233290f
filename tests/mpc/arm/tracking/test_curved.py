"""Muscles that are not affine in the pressure in an arm's MPC, against `allocate` and in a loop on the true laws."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import allocate
from allocator.muscles import TonduLopez2000
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N, TONDU_LOPEZ_LAAS_ARM
from allocator.units import BAR, DEG
from mpc.model.arm.model import Arm
from mpc.model.arm.tangents import TangentMuscle, allocated
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.plan import Rung
from mpc.trials.motions.arm_trajectories import reference
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import in_motion, simulate

AFFINE = Arm.machine("arm26")
LAWS = {
    "report": TONDU_DMSP_20_400N,
    "Tondu & Lopez": TonduLopez2000(0.01, 25 * DEG, 1.2, 0.5, 1 * BAR),
    "mixed": [TONDU_DMSP_20_400N, TONDU_DMSP_20_400N, TONDU_LOPEZ_LAAS_ARM, *3 * [SAROSI_DMSP_20_400N]],
}


def arm(name):
    return replace(AFFINE, mechanism=AFFINE.mechanism.with_muscles(LAWS[name]))


@pytest.mark.parametrize("law", [TONDU_DMSP_20_400N, LAWS["Tondu & Lopez"]])
def test_a_tangent_has_force_and_stiffness_of_its_law_at_its_pressure(law):
    eps, about = np.linspace(0.03, 0.2, 5), np.linspace(1, 4, 5) * BAR
    tangent = TangentMuscle(of=law, about=about)
    for name in ("law", "gain", "slope", "gain_slope"):
        assert getattr(tangent, name)(about, eps) == pytest.approx(getattr(law, name)(about, eps), rel=1e-9)
    step = 1e3
    assert tangent.law(about + step, eps) == pytest.approx(law.law(about + step, eps), rel=1e-4)


@pytest.mark.parametrize("name", LAWS)
def test_pressures_are_those_of_the_laws_themselves(name):
    rng, bent = np.random.default_rng(1), arm(name)
    q = rng.uniform(-0.3, 0.6, (12, 2))
    P = rng.uniform(1.0, 3.5, (12, 6)) * BAR
    T, K = bent.mechanism.torque(q, P), bent.mechanism.stiffness(q, P)
    found = allocated(bent, q, K, T, 0.0)
    exact = allocate(q, K, T, joint=bent.mechanism)
    assert np.abs(bent.mechanism.torque(q, found.P) - T).max() < 1e-6
    assert np.abs(bent.mechanism.stiffness(q, found.P) - bent.mechanism.stiffness(q, exact.P)).max() < 1e-4
    assert np.abs(found.P - exact.P).max() < 0.01 * BAR


def test_the_report_s_muscles_follow_a_circle():
    """The step is the readable one; K is what such muscles can have."""
    bent, circle = arm("report"), reference("circle", AFFINE).resampled(0.02)
    some = slice(0, 76)
    P = np.full((76, 6), 2.5 * BAR)
    asked = Reference(circle.t[some], circle.theta[some], bent.mechanism.stiffness(circle.theta[some], P))
    run = simulate(bent, TrackingMPC(bent, 0.02, 8, compiled=False), asked, x0=in_motion(bent, asked))
    assert (run.rung == Rung.QP).all()
    error = (run.theta - run.theta_ref)[:-10]  # the end comes without warning
    assert np.sqrt((error**2).mean(axis=0)).max() < 0.03 * DEG
    assert np.abs(run.K - run.K_ref).max() < 0.05 * np.abs(run.K_ref).max()


@pytest.mark.compiles
@pytest.mark.slow
def test_the_compiled_step_answers_as_the_readable_one():
    bent = arm("report")
    q = np.array([0.4, 0.6])
    K = bent.mechanism.stiffness(q, np.full(6, 2.5 * BAR))
    x = bent.at_rest(q, K)
    compiled, readable = (TrackingMPC(bent, N=8, solver="daqp", compiled=made) for made in (True, False))
    assert compiled.implementation == "compiled"
    for k in range(5):
        plans = [mpc.step(x, q + 0.01 * k, K) for mpc in (compiled, readable)]
        assert plans[0].u == pytest.approx(plans[1].u, abs=1e-5 * BAR)
        x = plans[0].x[1]
