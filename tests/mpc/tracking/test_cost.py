"""The cost is stated once: a line more in its table is charged alike wherever the cost is computed."""

from dataclasses import dataclass

import numpy as np
import pytest

from allocator import BAR, DEG
from mpc import KalmanObserver, NonlinearMPC, PlanStatus, Plant, TrackingMPC, Weights, sine
from mpc.export import export
from mpc.model.plant import NU, NX
from mpc.tracking import cost
from mpc.tracking.cost import NY, Residual, Rows, charges, diagonal, residuals
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import solver

from ...rigs import toolchain as tools
from ...rigs.needs import needs
from ...rigs.replay import CONTROL, record, replayed

PLANT, N = Plant(), 10
SIZES = Rows(NX, NY, NU, NU)


@dataclass(frozen=True)
class MoreWeights(Weights):
    """Weights of what is not charged for otherwise."""

    pressure: float = 1 / (0.01 * BAR) ** 2  # [cost]/[Pa]²
    antagonist: float = 0.5  # [cost]/[N]²


WEIGHTS = MoreWeights()


@pytest.fixture
def more(monkeypatch):
    """Two lines more."""
    lines = Residual("pressure", "x", (2, 3)), Residual("antagonist", "y", (2,))
    monkeypatch.setattr(cost, "residuals", lambda *sizes: (*residuals(*sizes), *lines))


def test_the_diagonal_and_the_charges_are_the_same_cost(more):
    rng = np.random.default_rng(0)
    rows = Rows(*(rng.normal(size=(size, 7)) for size in SIZES))
    by_weights = sum(np.sum(charge) for charge in charges(WEIGHTS, rows).values())
    by_rows = sum(np.sum(w[:, None] * r**2) / 2 for w, r in zip(diagonal(WEIGHTS), rows, strict=True))
    assert by_weights == pytest.approx(by_rows, rel=1e-12)
    assert set(charges(WEIGHTS, rows)) == {"theta", "omega", "K", "u", "rate", "pressure", "antagonist"}


def test_every_entry_is_charged_by_one_weight_at_most():
    entries = [(r.rows, i) for r in residuals() for i in r.entries]
    assert len(set(entries)) == len(entries)
    assert all(i < getattr(SIZES, rows) for rows, i in entries)
    assert {r.weight for r in residuals()} <= set(Weights.__dataclass_fields__)


@pytest.mark.compiles
def test_readable_and_compiled_qp_charge_for_a_new_line(more):
    mpc = TrackingMPC(PLANT, N=N, weights=WEIGHTS)
    usual = TrackingMPC(PLANT, N=N, weights=MoreWeights(pressure=1e-30, antagonist=1e-30))
    asked = PLANT.at_rest(0.05, 7.6), 5 * DEG, 7.9
    seen = mpc.qp(*asked)
    plan = mpc.step(*asked)
    arrays = seen.H, seen.f, seen.lower, seen.upper, seen.rows, seen.rows_lower, seen.rows_upper
    exact, multipliers = solver("daqp")(QP(*map(np.copy, arrays)))
    assert multipliers.any()
    np.testing.assert_allclose(mpc._qp_step.structured.z, exact[:-2], atol=1e-7)
    assert np.abs(plan.u - usual.step(*asked).u).max() > 1e-3 * BAR


@pytest.mark.compiles
def test_the_nonlinear_programme_charges_for_it_as_the_qps_do(more):
    x = PLANT.at_rest(0.05, 7.6)
    ours = TrackingMPC(PLANT, N=N, weights=WEIGHTS, iterations=20).step(x, 5 * DEG, 7.9)
    best = NonlinearMPC(PLANT, N=N, weights=WEIGHTS).step(x, 5 * DEG, 7.9)
    assert ours.status is best.status is PlanStatus.OPTIMAL
    np.testing.assert_allclose(ours.u, best.u, atol=1e-3 * BAR)


@pytest.mark.compiles
@needs("gcc")
def test_the_exported_c_charges_for_it_too(more, tmp_path):
    daqp = solver("daqp")
    controller = TrackingMPC(PLANT, N=N, weights=WEIGHTS, solver=lambda qp, limit=np.inf: daqp(qp, limit))
    observer = KalmanObserver(PLANT, 0.01)
    reference = sine(amplitude=20 * DEG, K=7.6, duration=1.5, ramp=0.5)
    done = record(PLANT, controller, observer, reference, lambda k: False)
    directory = export(tmp_path / "c", controller=controller, observer=observer)
    got = replayed(tools.compiled(directory, CONTROL, "vectors", *tools.QUICK), done.samples)
    np.testing.assert_allclose(got[:, :2], done.answers[:, :2], atol=1e-6 * BAR)
