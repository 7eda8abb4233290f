"""The slopes of tendons' lengths, which newer versions of MuJoCo keep sparse, are read here."""

from typing import Any

import numpy as np

from allocator.calculus import Array


class TendonJacobian:
    """A `TendonJacobian` reads ∂l/∂q (m, nv) [m] of all tendons, which newer versions of MuJoCo keep sparse."""

    def __init__(self, model: Any, data: Any) -> None:
        self._data, self._dense = data, np.zeros((model.ntendon, model.nv))
        self._sparse = np.asarray(data.ten_J).shape != self._dense.shape
        if self._sparse:
            import mujoco

            self._to_dense = mujoco.mju_sparse2dense
            holder = data if hasattr(data, "ten_J_rownnz") else model
            self._layout = [getattr(holder, f"ten_J_{part}").ravel() for part in ("rownnz", "rowadr", "colind")]

    def __call__(self) -> Array:
        """Return it as it is now; to be used before the next call."""
        if not self._sparse:
            return np.asarray(self._data.ten_J)
        self._to_dense(self._dense, self._data.ten_J.ravel(), *self._layout)
        return self._dense
