"""HPIPM is given the QP that our solver has, and answers that are off are not timed as if they were right."""

from math import inf

import numpy as np
import pytest

from mpc.tracking.qp.condense import condense
from mpc.tracking.qp.solvers import solver
from mpc.tracking.qp.step import certified

pytestmark = pytest.mark.slow

N = 10


@pytest.fixture
def part(benchmark_module):
    """A module of this part of the benchmark, by its name."""
    return lambda name: benchmark_module(f"speed.acados.{name}")


@pytest.fixture(params=["bare loop", "real plant"])
def recording(part, request):
    return part("recorded").LOOPS[request.param](N, 0.9)  # its slew limit binds, and a load comes at 0.6 s


def dense(recording, qp):
    return condense(recording.problem, qp.model, qp.feed, qp.u_last, qp.u_star_last)


def rolled_out(stages, v, slacks):
    """The states (N+1, 8) that changes (N, 2) and slacks (2,) lead to."""
    xi = np.zeros((len(v) + 1, 8))
    xi[0, 6:] = slacks
    for k, change in enumerate(v):
        xi[k + 1] = stages.A[k] @ xi[k] + stages.B[k] @ change
    return xi


def test_the_qp_by_stages_is_the_dense_one(part, recording):
    rng, qp = np.random.default_rng(3), recording.qps[-1]
    made, whole = part("stages").stages(recording.problem, qp), dense(recording, qp)

    def cost(z):
        v, xi = z[:-2].reshape(-1, 2), rolled_out(made, z[:-2].reshape(-1, 2), z[-2:])
        states = np.einsum("ki,kij,kj", xi, made.Q, xi) / 2 + (made.q * xi).sum()
        return states + np.einsum("ki,kij,kj", v, made.R, v) / 2 + (made.r * v).sum()

    for _ in range(5):
        z = rng.normal(size=whole.f.size)
        assert cost(z) == pytest.approx(whole.cost(z) / recording.problem.curvature, rel=1e-10)
        xi = rolled_out(made, z[:-2].reshape(-1, 2), z[-2:])
        rows = np.einsum("kij,kj->ki", made.C, xi)[1:]
        values = np.concatenate([xi[1:, 4:6].ravel(), rows[:, 0], rows[:, 1], rows[:, 2:].ravel()])
        np.testing.assert_allclose(values, whole.R @ z, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(made.v.reshape(2, -1), [whole.lower[:-2], whole.upper[:-2]], rtol=1e-12)
    for side, sides in zip(range(2), (whole.rows_lower, whole.rows_upper), strict=True):
        rows, w = made.rows[side, 1:], made.w[side, 1:].ravel()
        np.testing.assert_allclose(np.concatenate([w, rows[:, 0], rows[:, 1], rows[:, 2:].ravel()]), sides, rtol=1e-12)


@pytest.mark.parametrize(("chosen", "least"), [(0, 1.0), (1, 0.8), (2, 1.0)], ids=["cold", "warm", "balance"])
def test_hpipm_solves_the_qps_of_a_loop(part, recording, chosen, least):
    found = part("library").Library.found()
    assert found is not None  # the CasADi wheel has it
    hpipm = part("library").HPIPM(found, N, part("alone").SETTINGS[chosen])
    solved, binding = [], 0
    for qp in recording.qps[::8]:
        hpipm.take(part("stages").stages(recording.problem, qp))
        hpipm.solve()
        right = certified(solver("daqp"), dense(recording, qp), inf, recording.problem.curvature)
        solved.append(hpipm.status == 0)
        assert not solved[-1] or np.abs(hpipm.v.ravel() - right.z[:-2]).max() < 1e-4
        binding += bool(right.multipliers.any())
    assert np.mean(solved) >= least  # from far away a warm start fails now and then
    assert binding > 0


def test_a_setting_whose_answers_are_off_is_not_timed(part):
    alone, settings = part("alone"), part("alone").SETTINGS
    ours, seconds = np.full(200, 1e-5), np.tile([1e-5, 3e-5, 2e-5], (200, 1))
    apart, unsolved = np.zeros((200, 3)), np.zeros((200, 3))
    apart[:3, 0], unsolved[:3, 1] = 2e-4, 1.0  # the fastest is off, another says that it failed
    row = alone.compared("QP", alone.Timed(ours, seconds, apart, unsolved), settings, "GENERIC")
    assert row.rival == f"HPIPM {settings[2]}"
    assert row.ratio == pytest.approx(2.0)
    row = alone.compared("QP", alone.Timed(ours, seconds, apart + 1.0, unsolved), settings, "GENERIC")
    assert np.isnan(row.ratio)
    assert "answers are off" in row.note


def test_where_there_is_no_hpipm_or_acados_the_row_says_so(part, monkeypatch, tmp_path):
    rti, alone = part("rti"), part("alone")
    monkeypatch.setenv("ACADOS_SOURCE_DIR", str(tmp_path))
    assert not rti.available()
    monkeypatch.delenv("ACADOS_SOURCE_DIR")
    assert not rti.available()
    monkeypatch.setattr(alone.Library, "found", classmethod(lambda cls: None))
    rows = list(alone.measure(N))
    assert len(rows) == len(alone.LOOPS)
    assert all("was not found" in row.note for row in rows)
