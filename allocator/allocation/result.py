"""Answer of `allocate`: pressures, the torques and stiffnesses that they give, and the binding limits.

All of it is computed from the pressures; no back-end's report is trusted.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.status import Status
from allocator.allocation.uncertain.spread import Spread
from allocator.calculus import Array, Value
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles.measured import Visit, extrapolation


class Allocation(ABC):
    """Result of `allocate`.

    Of a joint it is a `PairAllocation`: `theta`, `T`, `K` are numbers, or arrays of the targets' broadcast shape. Of a
    mechanism it is a `BoxAllocation`: postures and torques are (…, n), stiffnesses (…, n, n). Both have

    * `theta` requested and `q` solved for; `P`, of a pair `P1` and `P2`; the values achieved: `T`, `K`,
      `isobaric_stiffness`, `forces`; `T_target`, `K_target` and the errors, `torque_met`, `stiffness_met`, `holds`,
      `least_stiffness`;
    * `status`, `success`, `message`, `assumed`; the limits by name: `active`, `broken`, and as pressures: `box`;
    * standard deviations by the covariance of fitted muscles: `K_std`, `forces_std`;
    * the proof: `gap`, `kkt_residual`; `kind` (which stiffness), `method`, `jacobian()`, `to_dict()`.
    """

    if TYPE_CHECKING:  # each kind of allocation has these, as fields or properties

        @property
        def status(self) -> Any:
            """`Status`, or an array of its integers."""

        @property
        def T_target(self) -> Value:
            """Requested torque [N·m]."""

        @property
        def K_target(self) -> Value:
            """Requested stiffness [N·m/rad]; NaN for free entries."""

        @property
        def T(self) -> Value:
            """Torque that these pressures give [N·m]."""

        @property
        def K(self) -> Value:
            """Stiffness that these pressures give [N·m/rad], of the kind asked for."""

        @property
        def P(self) -> Array:
            """Pressures (…, m) [Pa]."""

        @property
        def active(self) -> Any:
            """Names of the limits that bind, a tuple or an array of tuples."""

        @property
        def broken(self) -> Any:
            """Names of the limits that are not kept, likewise."""

        @property
        def _shape(self) -> tuple[int, ...]:
            """Shape of the targets."""

    @property
    def success(self) -> Any:
        """Whether torques and stiffness are met without a fault."""
        return self.status == Status.EXACT

    @property
    def T_error(self) -> Value:
        """Torque asked minus given [N·m]."""
        return self.T_target - self.T

    @property
    def K_error(self) -> Value:
        """Stiffness asked minus given [N·m/rad]; NaN for entries that were not asked for."""
        return self.K_target - self.K

    @cached_property
    def forces(self) -> Array:
        """Muscle forces (…, m) [N] at these pressures; negative for a slack muscle."""
        return self._array(np.stack([side.force(P) for side, P in self._pulling], axis=-1))

    @cached_property
    def isobaric_stiffness(self) -> Value:
        """Stiffness -∂T/∂θ at constant pressures [N·m/rad], whichever kind was requested."""
        return self._formed(np.asarray(sum(side.isobaric.stiffness(P) for side, P in self._pulling)))

    @cached_property
    def K_std(self) -> Value:
        """Standard deviation of K [N·m/rad] from the covariance of fitted muscles, entry by entry; None without one.

        That of a fitted joint allows for a smooth error of its force law; that of muscles fitted to forces does not.
        """
        return None if self._spread is None else self._formed(self._spread.stiffness_std)

    @cached_property
    def forces_std(self) -> Array | None:
        """Standard deviations of the forces (…, m) [N] from the covariance of fitted muscles; None without one.

        They are wide if the joint's fit could not identify the force common to both muscles.
        """
        return None if self._spread is None else self._array(self._spread.forces_std)

    @property
    def assumed(self) -> str:
        """Sentence listing the assumptions behind the answer that the data could not confirm, or "".

        Muscles fitted to forces are extrapolated beyond the contractions and pressures at which they were measured.
        """
        return extrapolation(Visit(s.name, s.muscle.region, s.contraction, P) for s, P in self._pulling)

    @property
    def message(self) -> str:
        """Sentence on the achieved values, the limits in the way and the assumptions."""
        return "; ".join(filter(None, (self._outcome, self.assumed)))

    @property
    def _outcome(self) -> str:
        if not self._shape:
            return self._sentence
        values, counts = np.unique(self.status, return_counts=True)
        listed = ", ".join(f"{n} {Status(int(v)).name}" for v, n in zip(values, counts, strict=True))
        return f"{self.status.size} target{'s' * (self.status.size != 1)}: {listed}"

    @property
    def _sentence(self) -> str:
        """Message about one target, without assumptions: the achieved values and the limits in the way."""
        if self.success:
            return Status(self.status).advice
        kept = [name for name in self.active if name not in self.broken]
        limits = {"in the way": kept, "not kept": self.broken}
        told = [*self._details, *(f"{what}: {', '.join(listed)}" for what, listed in limits.items() if listed)]
        return Status(self.status).advice + (f" ({'; '.join(told)})" if told else "")

    @abstractmethod
    def jacobian(self) -> Array:
        """Return dP/d(θ, K, T) (…, m, n + n(n+1)/2 + n), with the active set held; of K the upper triangle.

        In [Pa/rad, Pa·rad/(N·m), Pa/(N·m)]. One-sided where the active set is about to change.
        """

    @abstractmethod
    def to_dict(self) -> dict[str, object]:
        """Return the answer by name, units in the names: pressures, achieved values, status and binding limits."""

    @property
    @abstractmethod
    def _details(self) -> list[str]:
        """Errors of the one target, in numbers."""

    @property
    @abstractmethod
    def _spread(self) -> Spread | None:
        """Lᵀ∂/∂p of the answers, None without a covariance."""

    @property
    @abstractmethod
    def _muscles(self) -> Sequence[OneMuscle]:
        """Muscles at the postures answered, flat (N or 1, …)."""

    @property
    def _pulling(self) -> list[tuple[OneMuscle, Array]]:
        """Each muscle with its pressures (N,)."""
        return list(zip(self._muscles, np.reshape(self.P, (-1, self.P.shape[-1])).T, strict=True))

    def _array(self, array: Array) -> Array:
        """Return rows (N or 1, …) in the shape of the targets, as arrays also for one target."""
        formed: Array = self._formed(array)
        return formed

    def _formed(self, array: NDArray[Any]) -> Any:
        """Return a flat array (N or 1, …) in the shape of the targets; a Python scalar if it is one number."""
        return shaped(array, self._shape)

    def _listed(self, names: Iterable[tuple[str, ...]]) -> Any:
        """Return names of limits of N targets in their shape: an array of tuples, of one target its tuple."""
        array = np.empty(prod(self._shape), object)
        array[:] = list(names)
        return array.reshape(self._shape) if self._shape else array[0]


def from_fields(of: type[Any], fields: Mapping[str, object]) -> Any:
    """Make an allocation from its fields by name: the constructor of a frozen dataclass takes five times as long."""
    allocation = object.__new__(of)
    object.__setattr__(allocation, "__dict__", fields)
    return allocation


def shaped(array: NDArray[Any], shape: tuple[int, ...]) -> Any:
    """Return a flat array (N or 1, …) in the shape of N targets, read-only; a Python scalar if it is one number."""
    own = array.shape[1:]
    if not shape and not own:
        return array.item()
    if len(array) != (size := prod(shape)):
        array = np.broadcast_to(array, (size, *own))
    view = array.reshape(shape + own)
    view.flags.writeable = False
    return view


def as_status(codes: NDArray[np.int8], shape: tuple[int, ...]) -> Any:
    """Return the statuses (N,) in the shape of N targets: integers, or the `Status` of one."""
    return shaped(codes, shape) if shape else Status(int(codes[0]))
