"""Structured QP of an arm, solved sample by sample like a joint's."""

from math import nan

import numpy as np

from allocator.units import BAR
from mpc.codegen.views import flat, in_python, length_of
from mpc.model.arm.model import Arm
from mpc.tracking.compiled.arm.module import solve_module
from mpc.tracking.compiled.arm.records import ArmAlong
from mpc.tracking.compiled.factory import setting
from mpc.tracking.compiled.records import Given
from mpc.tracking.compiled.sample.calls import address_of
from mpc.tracking.compiled.structured_qp.structured import SolvedQP, StructuredQP
from mpc.tracking.linearise import Linearisation
from mpc.tracking.qp.condense import TrackingProblem


class SizedQP(StructuredQP):
    """Structured QP of one controller of an arm; two threads must not use its arrays at the same time."""

    def __init__(self, arm: Arm, dt: float, problem: TrackingProblem) -> None:
        SolvedQP.__init__(self, problem, arm.m)
        module, N = solve_module(arm), sum(problem.blocks)
        self.problem, self._settle, self._stiffnesses = problem, module.settle_path, arm.stiffnesses
        given, buffer = (np.zeros(length_of(record, N, known=module.ARM)) for record in (Given, ArmAlong))
        self.given = in_python(module.given_in)(given)
        along: ArmAlong = in_python(module.path_in)(buffer)
        self._arm_path, self.u = along
        self._arm_path.kept[:] = np.exp(-dt / arm.lags)
        made = setting(problem, in_bar=True)
        self.arrays = flat(made), made.starts, given, buffer
        self.counted = np.zeros(1, np.int64)
        self._limit = np.isnan(flat(made._replace(exchanges=nan)))
        address_of(self._settle)  # compiles it

    @property
    def model(self) -> Linearisation:
        """Path as a linearisation of the readable step; copies."""
        (x, S, y, slope, kept), k = self._arm_path, self._stiffnesses
        N, moving, m = len(S), S.shape[1], kept.size
        A, B = np.zeros((N, moving + m, moving + m)), np.zeros((N, moving + m, m))
        A[:, :moving], B[:, :moving] = S[:, :, : moving + m], S[:, :, moving + m :]
        A[:, moving:, moving:], B[:, moving:] = np.diag(kept), np.diag(1 - kept)
        gradient = np.zeros((N + 1, y.shape[1], moving + m))
        n = moving // 2
        gradient[:, :, :n], gradient[:, :, moving:] = slope[:, :n].swapaxes(1, 2), slope[:, n:].swapaxes(1, 2)
        outputs = y[:, :k].copy(), y[:, k:].copy(), A, B, gradient[:, :k], gradient[:, k:]
        return Linearisation(BAR * self.u, x.copy(), *outputs)
