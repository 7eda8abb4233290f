"""The report on arms: small runs of its parts, and that a missed figure fails it."""

import numpy as np
import pytest

from allocator.units import DEG
from mpc.model.arm.model import Arm
from mpc.tracking.controller import TrackingMPC
from mpc.trials.motions.arm_trajectories import hold
from mpc.trials.simulation import simulate

ARM = Arm.machine("arm26")

pytestmark = pytest.mark.slow


def test_ipopt_s_first_commands_are_those_of_the_qp(benchmark_module):
    """One QP about the previous plan is the programme to first order: near rest both say the same."""
    ipopt = benchmark_module("arm.ipopt")
    K = np.array([[12.0, 4.6], [4.6, 9.5]])
    x = ARM.at_rest((0.1, 0.2), K)
    x[0] += 1e-4
    ours, theirs = TrackingMPC(ARM, N=5, iterations=5, compiled=False), ipopt.nonlinear(ARM, N=5, compiled=False)
    for _ in range(2):
        plans = [controller.step(x, (0.1, 0.2), K) for controller in (ours, theirs)]
    np.testing.assert_allclose(plans[0].u, plans[1].u, atol=50.0)  # Pa
    assert theirs._qp_step.failures == 0


def test_the_report_counts_what_is_missed(benchmark_module, tmp_path):
    main = benchmark_module("arm.__main__")
    lines = [main.Line("arm26", "angle", 0.02, 0.03), main.Line("arm26", "time", float("nan"), 300.0)]
    assert [line.failed for line in lines] == [False, True]
    main.write(lines, [], tmp_path)
    text = (tmp_path / "arm.md").read_text(encoding="utf-8")
    assert "| arm26 | angle | 0.02 | 0.03 |" in text
    assert text.count("**missed**") == 1


def test_mpc_and_pid_hold_the_rough_arm_and_the_mpc_sooner(benchmark_module):
    rough, cases = benchmark_module("arm.rough"), benchmark_module("arm.cases")
    found = {}
    for kind, build in (("MPC", rough.mpc), ("PID", rough.pid)):
        controller, observer = build(ARM, **rough.TUNED[kind, "arm26"])
        done = simulate(cases.rough_plant(ARM, 1), controller, hold(ARM, 1.5), observer=observer, seed=1)
        found[kind] = np.abs((done.theta - done.theta_ref)[-50:]).mean() / DEG
    assert found["MPC"] <= 0.05
    assert 3 * found["MPC"] < found["PID"] < 3.0
