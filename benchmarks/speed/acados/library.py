"""HPIPM by its C interface: the library, and a solver of QPs by stages.

It is searched in `$ACADOS_SOURCE_DIR/lib`, the place of acados, and in the CasADi wheel, which has a generic BLASFEO.
The library reports the sizes of structures and memories; no layout is assumed.
"""

import ctypes
import os
import re
import sys
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from allocator.calculus import Array
from benchmarks.speed.acados.stages import NG, NV, NX, SLACKS, Stages, W

ALIGNMENT = 64  # [B] of memories
MOST = 50  # iterations, as in acados
TOLERANCE = 1e-8  # of all four residuals; at 1e-6 commands are off by up to 6e-4 bar
START = 1e3  # initial μ: from 1e2 to 1e4 times agree within a tenth, and all QPs of both loops at N = 20 are solved
SIZES = ("d_ocp_qp_dim", "d_ocp_qp", "d_ocp_qp_sol", "d_ocp_qp_ipm_arg", "d_ocp_qp_ipm_ws")


class Mode(IntEnum):
    """Modes of HPIPM."""

    SPEED = 1
    BALANCE = 2


class Settings(NamedTuple):
    """Choice of HPIPM's settings."""

    mode: Mode
    warm: bool  # whether it starts from the previous solution and its multipliers

    def __str__(self) -> str:
        return f"{self.mode.name} {'warm' if self.warm else 'cold'}"


class Library:
    """Loaded HPIPM library."""

    def __init__(self, folder: Path, headers: Path) -> None:
        self._blas = ctypes.CDLL(str(_file(folder, "blasfeo")))  # first: HPIPM loads it by name alone
        self.functions: Any = ctypes.CDLL(str(_file(folder, "hpipm")))
        self._target = headers / "blasfeo_target.h"
        for name in SIZES:
            for kind in ("strsize", "memsize"):
                getattr(self.functions, f"{name}_{kind}").restype = ctypes.c_size_t

    @classmethod
    def found(cls) -> Self | None:
        """Return the library, or None."""
        import casadi

        wheel = Path(casadi.__file__).parent
        places = [(wheel, wheel / "include")]
        if root := os.environ.get("ACADOS_SOURCE_DIR"):
            places.insert(0, (Path(root) / "lib", Path(root) / "include" / "blasfeo" / "include"))
        for folder, headers in places:
            if _file(folder, "hpipm").exists() and _file(folder, "blasfeo").exists():
                return cls(folder, headers)
        return None

    @cached_property
    def target(self) -> str:
        """Return the target processor of its linear algebra."""
        try:
            found = re.search(r"#ifndef TARGET_(\w+)", self._target.read_text(encoding="utf-8"))
        except FileNotFoundError:
            found = None
        return found[1] if found else "unknown"


def _file(folder: Path, name: str) -> Path:
    pattern = {"darwin": "lib{}.dylib", "win32": "lib{}.dll"}.get(sys.platform, "lib{}.so")
    return folder / pattern.format(name)


class HPIPM:
    """HPIPM's interior point for QPs over a horizon."""

    def __init__(self, library: Library, N: int, settings: Settings) -> None:
        self.N, self.settings, self._f = N, settings, library.functions
        self._kept: list[Any] = []  # memory referenced by HPIPM
        f = self._f
        dim = self._structure("d_ocp_qp_dim")
        f.d_ocp_qp_dim_create(N, dim, self._memory(f.d_ocp_qp_dim_memsize(N))[0])
        for k in range(N + 1):
            inner, last = k > 0, k == N
            sizes = {"nx": NX if inner else 2, "nu": 0 if last else NV, "nbx": 2, "nbu": 0 if last else NV}
            for field, size in {**sizes, "ng": NG if inner else 0}.items():
                f.d_ocp_qp_dim_set(field.encode(), k, size, dim)
        self._qp, self._solution, self._options = map(self._structure, SIZES[1:4])
        f.d_ocp_qp_create(dim, self._qp, self._memory(f.d_ocp_qp_memsize(dim))[0])
        self._where = self._memory(f.d_ocp_qp_sol_memsize(dim))
        f.d_ocp_qp_sol_create(dim, self._solution, self._where[0])
        f.d_ocp_qp_ipm_arg_create(dim, self._options, self._memory(f.d_ocp_qp_ipm_arg_memsize(dim))[0])
        self._set_options()
        self._work = self._structure("d_ocp_qp_ipm_ws")
        memory, _ = self._memory(f.d_ocp_qp_ipm_ws_memsize(dim, self._options))
        f.d_ocp_qp_ipm_ws_create(dim, self._options, self._work, memory)
        self._arguments = self._qp, self._solution, self._options, self._work
        self.solve_call = f.d_ocp_qp_ipm_solve

    def _structure(self, name: str) -> Any:
        self._kept.append(ctypes.create_string_buffer(getattr(self._f, f"{name}_strsize")()))
        return self._kept[-1]

    def _memory(self, size: int) -> tuple[Any, int]:
        """Return aligned memory, and its size [B]."""
        buffer = ctypes.create_string_buffer(size + ALIGNMENT)
        self._kept.append(buffer)
        return ctypes.c_void_p(-(-ctypes.addressof(buffer) // ALIGNMENT) * ALIGNMENT), size

    def _set_options(self) -> None:
        f = self._f
        f.d_ocp_qp_ipm_arg_set_default(int(self.settings.mode), self._options)
        tolerances = dict.fromkeys(("tol_stat", "tol_eq", "tol_ineq", "tol_comp"), ctypes.c_double(TOLERANCE))
        numbers = {"mu0": ctypes.c_double(START), "iter_max": ctypes.c_int(MOST)}
        warm = {"warm_start": ctypes.c_int(2 if self.settings.warm else 0)}
        for field, value in {**tolerances, **numbers, **warm}.items():
            f.d_ocp_qp_ipm_arg_set(field.encode(), ctypes.byref(value), self._options)

    def _set(self, field: str, k: int, values: Any, kind: Any = float) -> None:
        array = np.asfortranarray(values, kind)
        self._f.d_ocp_qp_set(field.encode(), k, array.ctypes.data_as(ctypes.c_void_p), self._qp)

    def take(self, stages: Stages) -> None:
        """Take a QP."""
        for k in range(self.N + 1):
            there = slice(None) if k else SLACKS  # the states of this stage
            if k < self.N:
                self._set("A", k, stages.A[k][:, there])
                self._set("B", k, stages.B[k])
                self._set("b", k, np.zeros(NX))
                self._set("R", k, stages.R[k])
                self._set("r", k, stages.r[k])
                self._set("S", k, np.zeros((NV, len(stages.q[k][there]))))
                self._bound("u", k, range(NV), stages.v[:, k])
            self._set("Q", k, stages.Q[k][there][:, there])
            self._set("q", k, stages.q[k][there])
            if k == 0:
                self._bound("x", k, range(2), np.array([[0.0, 0.0], [np.inf, np.inf]]))
                continue
            self._bound("x", k, W, stages.w[:, k])
            self._set("C", k, stages.C[k])
            if k < self.N:
                self._set("D", k, np.zeros((NG, NV)))
            self._sides("g", k, stages.rows[:, k])

    def _bound(self, kind: str, k: int, places: Any, sides: Array) -> None:
        self._set(f"idxb{kind}", k, list(places), np.int32)
        self._sides(f"b{kind}", k, sides)

    def _sides(self, kind: str, k: int, sides: Array) -> None:
        """Set lower and upper sides; infinite ones are masked."""
        for side, values in zip("lu", sides, strict=True):
            name = f"{side}{kind}"
            self._set(name, k, np.where(np.isfinite(values), values, 0.0))
            self._set(f"{name}_mask", k, np.isfinite(values))

    def solve(self) -> None:
        """Solve the QP; only this call is timed."""
        self.solve_call(*self._arguments)

    @property
    def status(self) -> int:
        """Status by HPIPM, 0 if solved."""
        return self._number("status")

    @property
    def iterations(self) -> int:
        """Iterations of the last solution."""
        return self._number("iter")

    def _number(self, field: str) -> int:
        number = ctypes.c_int()
        self._f.d_ocp_qp_ipm_get(field.encode(), self._work, ctypes.byref(number))
        return number.value

    @property
    def v(self) -> Array:
        """Changes of the commands (N, 2) [bar]."""
        found = np.empty((self.N, NV))
        for k in range(self.N):
            self._f.d_ocp_qp_sol_get(b"u", k, self._solution, found[k].ctypes.data_as(ctypes.c_void_p))
        return found

    @property
    def remembered(self) -> bytes:
        """Solution and multipliers for a warm start."""
        return ctypes.string_at(*self._where)

    @remembered.setter
    def remembered(self, memory: bytes) -> None:
        ctypes.memmove(self._where[0], memory, self._where[1])
