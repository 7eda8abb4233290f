"""The first use of an arm, where nothing is compiled yet, and what is said meanwhile."""

import numpy as np
import pytest

from allocator.compilation import beside
from mpc.codegen import modules
from mpc.model.arm.model import Arm
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.compiled.factory import compile_step
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.plan import Rung
from mpc.tracking.qp.step import CompilingBeside
from mpc.trials.motions.arm_trajectories import hold
from mpc.trials.simulation import simulate

ARM = Arm.machine("arm26")


@pytest.fixture
def nothing_compiled(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    modules.imported.cache_clear()
    yield
    modules.imported.cache_clear()


@pytest.mark.usefixtures("nothing_compiled")
def test_an_arm_moves_at_once_while_another_process_compiles(monkeypatch):
    begun = []
    monkeypatch.setattr(beside, "begin", lambda *arguments: begun.append(arguments) or True)
    with beside.only_kept():
        with pytest.warns(CompilingBeside, match="compiles the controller's step .* a minute") as said:
            controller = TrackingMPC(ARM, 0.02, 8, wait=False)
        run = simulate(ARM, controller, hold(ARM, 0.2), observer=KalmanObserver(ARM, 0.02, wait=False))
    assert len(said) == 1
    assert controller.implementation == run.implementation == "readable"
    assert [work for _, _, work, *_ in begun if work is compile_step] == [compile_step]
    assert begun[0][3:] == (ARM, 0.02)
    assert (run.rung == Rung.QP).all()
    assert np.abs(run.theta - run.theta_ref).max() < 1e-6
