"""`PressureGovernor` is the value that governs the pressures of a mechanism."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cached_property
from math import isfinite
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.compilation import jit
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.limits import BINDS
from allocator.mechanism import Mechanism, Pulleys
from allocator.mechanism.kernel.data import workspace
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc.governor import kernel
from mpc.governor.model import points, ways_function

_NEAREST = np.deg2rad(1.0)  # [rad] of the way to an end: nearer is not told apart
_CHUNK = 4096  # commands that go through the formulas at once
_PAYS = 5_000  # commands for which a call may wait for the compiler
_KEPT = 4  # numbers of commands whose memory is kept
_NAMES = "q", "omega", "P", "command", "previous"
_FREE = 1e6  # [rad] of a joint without end stops


class GovernorStatus(IntEnum):
    """A `GovernorStatus` is what became of a command; where several hold the last but for BAD_INPUT."""

    SAFE = kernel.SAFE  # unchanged
    MOVED = kernel.MOVED  # moved to the nearest pressures that keep all limits
    NOT_KEPT = kernel.NOT_KEPT  # no pressures keep the joint range or the energy: those that exceed them least
    CONFLICT = 5  # the limits of a muscle contradict each other: the supply was kept first
    SLACK = 6  # a muscle can have no pressure that keeps it taut
    OUTSIDE_LIMITS = 9  # the slew leaves a muscle no pressure in its supply
    BAD_INPUT = kernel.BAD_INPUT  # a command is no number: the muscle's previous one is in its place


class Governed(NamedTuple):
    """`Governed` are safe pressures, and what became of the commands."""

    P: Array  # (…, m) [Pa]
    status: Any  # GovernorStatus, or an array (…) of its integers


@dataclass(frozen=True)
class PressureGovernor:
    """A `PressureGovernor` keeps supply, slew and tautness always, and joint range and energy where pressures can.

    The joints stay in their range if the pressures, held, would stop the arm before an end: the work of the muscles on
    the way there must use up its kinetic energy (`mpc.governor.kernel.range_rows`). Friction, which helps, is left out.

    Of one joint that is exact but for the lag. Of several it holds at the postures at the ends that are looked at
    (`mpc.governor.model.PER_END`), and is no proof: arms that are pushed to their ends as hard as the slew lets them
    have left their range on the model (`python -m benchmarks.governor`). Keep a `margin`, believe NOT_KEPT, and keep
    end stops.
    """

    mechanism: Mechanism  # or an `AntagonistJoint`, of which one is made
    dt: float  # sample time [s]
    slew: float  # greatest change of a command [Pa/s]
    inertia: Any  # M (n, n) [kg·m²], its diagonal (n) or a number; or a function q ↦ M of CasADi expressions
    load: tuple[float, ...] = ()  # greatest torque on each joint from outside, gravity included (n) [N·m]; by default 0
    lag: float = 0.0  # of the pressures behind the commands [s]
    margin: float = 0.0  # that the joints keep from their ends [rad]
    min_force: float = 0.0  # that keeps a muscle taut [N]
    max_energy: float | None = None  # greatest kinetic energy [J], what a contact can receive

    def __post_init__(self) -> None:
        """Check the parts against each other. Raises `InvalidInput`."""
        given: object = self.mechanism
        mechanism = Mechanism.from_joint(given) if isinstance(given, AntagonistJoint) else given
        if not isinstance(mechanism, Mechanism):
            raise InvalidInput(f"mechanism is a {type(given).__name__}; expected a Mechanism or a joint")
        object.__setattr__(self, "mechanism", mechanism)
        n = self.mechanism.n
        load = checks.real("PressureGovernor: load", self.load if np.size(self.load) else 0.0, "N·m")
        if load.shape not in ((), (n,)) or not (load >= 0).all():
            raise InvalidInput(f"PressureGovernor: load has to be one number or n = {n}, not negative [N·m]")
        object.__setattr__(self, "load", tuple(np.broadcast_to(load, (n,)).tolist()))
        if not callable(self.inertia):
            object.__setattr__(self, "inertia", _inertia(self.inertia, n))
        for name, unit, least in (("dt", "s", 1e-6), ("slew", "Pa/s", 1e3), ("lag", "s", 0.0), ("margin", "rad", 0.0)):
            number = checks.number(f"PressureGovernor: {name}", getattr(self, name), unit)
            if not number >= least:
                raise InvalidInput(f"PressureGovernor: {name} = {number:g} {unit} has to be at least {least:g}")
            object.__setattr__(self, name, number)
        object.__setattr__(self, "min_force", checks.number("PressureGovernor: min_force", self.min_force, "N"))
        if self.max_energy is not None and not checks.number("PressureGovernor: max_energy", self.max_energy, "J") > 0:
            raise InvalidInput(f"PressureGovernor: max_energy = {self.max_energy:g} J has to be positive")
        limits = self.mechanism.angle_limits
        if limits is not None and min(high - low for low, high in limits) <= 2 * self.margin:
            raise InvalidInput(f"PressureGovernor: margin = {self.margin:g} rad leaves a joint no range")
        self._ways  # noqa: B018  # muscles and routes that cannot be governed are refused here

    @classmethod
    def of_arm(cls, arm: Any, dt: float, **others: Any) -> Self:
        """Return the governor of an `mpc.arm.model.Arm`: slew, lag and inertia are its own.

        The load is the greatest gravity at 500 random postures. `others` are further fields.
        """
        low, high = arm.angle_limits
        postures = np.random.default_rng(0).uniform(low, high, (500, arm.n))
        load = np.max([np.abs(arm.bodies.gravity_torque(q)) for q in postures], axis=0)
        given = {"slew": arm.slew, "lag": float(max(arm.lags)), "inertia": arm.bodies.mass_matrix, "load": load}
        return cls(arm.mechanism, dt, **(given | others))

    def __call__(
        self, q: ArrayLike, omega: ArrayLike, P: ArrayLike, command: ArrayLike, previous: ArrayLike | None = None
    ) -> Array:
        """Return the nearest safe pressures (…, m) [Pa]; arguments as in `govern`."""
        return self.govern(q, omega, P, command, previous).P

    def govern(
        self, q: ArrayLike, omega: ArrayLike, P: ArrayLike, command: ArrayLike, previous: ArrayLike | None = None
    ) -> Governed:
        """Return the safe pressures nearest to `command` (…, m) [Pa], and what became of it.

        Parameters
        ----------
        q, omega
            Angles [rad] and rates [rad/s] of the joints (…, n).
        P
            Pressures now (…, m) [Pa].
        command
            The pressures somebody would like to have (…, m) [Pa]; any numbers, NaN and infinite ones included.
        previous
            The pressures commanded last (…, m) [Pa], from which the slew counts; by default `P`.

        Raises
        ------
        InvalidInput
            For shapes that do not fit, and angles, rates or pressures that are not finite.
        """
        given = self._checked(q, omega, P, command, P if previous is None else previous)
        shape = given[3].shape[:-1]
        flat = [np.ascontiguousarray(a.reshape(-1, a.shape[-1])) for a in given]
        safe, status = np.empty_like(flat[3]), np.empty(len(flat[3]), np.int64)
        govern, memory = _loop(len(safe)), self._formulas(1).memory
        for begin in range(0, len(safe), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            at, omegas, pressures, commands, before = (a[part] for a in flat) if len(safe) > _CHUNK else flat
            reach = self.slew * self.dt
            aim = np.clip(np.where(np.isfinite(commands), commands, before), before - reach, before + reach)
            ways = self._formulas(len(at)).at(at, omegas, pressures, before, aim)
            govern(ways, self._rules, omegas, before, commands, safe[part], status[part], *memory)
        if not shape:
            return Governed(safe[0], GovernorStatus(int(status[0])))
        return Governed(safe.reshape(*shape, -1), status.reshape(shape))

    def _checked(self, *given: Any) -> list[Array]:
        """Return q, ω, P, command and the previous one as arrays with a common leading shape. Raises `InvalidInput`."""
        arrays = [np.asarray(value, float) for value in given]
        for name, array, size in zip(_NAMES, arrays, self._sizes, strict=True):
            if array.ndim == 0 or array.shape[-1] != size:
                raise InvalidInput(f"{name} has the shape {array.shape}; expected (…, {size})")
            if name != "command" and not isfinite(np.add.reduce(array, axis=None)):  # in half the time of isfinite
                raise InvalidInput(f"{name} has to be finite; only a command may be anything")
        if all(array.ndim == 1 for array in arrays):
            return arrays
        try:
            shape = np.broadcast_shapes(*(array.shape[:-1] for array in arrays))
        except ValueError:
            raise InvalidInput(f"leading shapes do not broadcast: {[a.shape for a in arrays]}") from None
        return [np.broadcast_to(array, (*shape, array.shape[-1])) for array in arrays]

    @cached_property
    def _sizes(self) -> tuple[int, ...]:
        return (self.mechanism.n,) * 2 + (self.mechanism.m,) * 3

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields alone: what has been made of them is made again in another process."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def _ways(self) -> Any:
        limits = self.mechanism.angle_limits or ((-_FREE, _FREE),) * self.mechanism.n
        ends = np.array([(low + self.margin, high - self.margin) for low, high in limits])
        inertia = self.inertia if callable(self.inertia) else np.array(self.inertia)
        return ways_function(self.mechanism, ends, _NEAREST, inertia, np.array(self.load), self.lag)

    @cached_property
    def _kept(self) -> threading.local:
        return threading.local()

    def _formulas(self, N: int) -> "_Formulas":
        """Return the formulas for N postures with their memory, which every thread has for itself."""
        kept: dict[Any, _Formulas] = self._kept.__dict__
        if N not in kept:
            if len(kept) > _KEPT:
                kept.clear()
            kept[N] = _Formulas.of(self, N)
        return kept[N]

    @cached_property
    def _rules(self) -> kernel.Rules:
        lo, hi = self.mechanism.pressure_limits
        return kernel.Rules(
            load=np.array(self.load),
            most=np.array([min(hi, muscle.max_pressure) for muscle in self.mechanism.muscles]),
            least=lo,
            min_force=self.min_force,
            step=self.slew * self.dt,
            near=BINDS * (hi - lo),
            unit=hi,
            reaction=self.lag + self.dt,
            energy=np.inf if self.max_energy is None else self.max_energy,
        )


@dataclass(frozen=True)
class _Formulas:
    """The formulas are CasADi's, evaluated without a copy, with the memory of the kernel."""

    given: tuple[Array, ...]  # q, ω (N, n), P, the last command and what is aimed at (N, m)
    ways: kernel.Ways
    evaluate: Callable[[], None]
    buffer: Any  # that it fills; it has to stay
    memory: tuple[Any, Any]

    @classmethod
    def of(cls, governor: PressureGovernor, N: int) -> "_Formulas":
        """Return those for N postures."""
        n, m = governor.mechanism.n, governor.mechanism.m
        given, r = tuple(np.empty((N, size)) for size in (n, n, m, m, m)), points(n)
        shapes = [(m,), (m,), (n, m), (n,), (n,), (n,), (1,), (r, m), (r,), (r,)]
        ways = kernel.Ways(*(np.empty((N, *shape)) for shape in shapes))
        buffer, evaluate = (governor._ways if N == 1 else governor._ways.map(N)).buffer()
        view: Any = memoryview
        for i, array in enumerate(given):
            buffer.set_arg(i, view(array))
        for i, array in enumerate(ways):
            buffer.set_res(i, view(array))
        memory = kernel.memory_for(r + 1, m), workspace(r + 1, m, 1)
        return cls(given, ways, evaluate, buffer, memory)

    def at(self, *states: Array) -> kernel.Ways:
        """Return what they say of states: q, ω (N, n), P, the last command and what is aimed at (N, m)."""
        for array, values in zip(self.given, states, strict=True):
            array[...] = values
        self.evaluate()
        return self.ways


def _inertia(value: Any, n: int) -> tuple[tuple[float, ...], ...]:
    """Return M (n, n) of a number, a diagonal (n) or a matrix (n, n). Raises `InvalidInput`."""
    array = checks.real("PressureGovernor: inertia", value, "kg·m²")
    wrong = f"PressureGovernor: inertia has to be M ({n}, {n}), positive definite, its diagonal or a number [kg·m²]"
    if array.shape not in ((), (n,), (n, n)):
        raise InvalidInput(wrong)
    matrix = array if array.ndim == 2 else np.diag(np.broadcast_to(array, n))
    if not np.allclose(matrix, matrix.T) or not (np.linalg.eigvalsh(matrix) > 0).all():
        raise InvalidInput(wrong)
    return tuple(map(tuple, matrix.tolist()))


_ready: list[jit.Function] = []  # the loop, once it is compiled


def _loop(commands: int) -> jit.Function:
    """Return the compiled loop where it is there or pays, else plain Python."""
    if not _ready and commands < _PAYS:
        return kernel.govern_batch
    if not _ready:
        made = jit.compiled(kernel.govern_batch, kernel.FUNCTIONS, inline=True, unaliased=True)
        _ready.append(made or kernel.govern_batch)
    return _ready[0]


def warm_up() -> bool:
    """Compile now what governors need, so that every later call is fast; False where that cannot be done.

    It takes half a minute after an installation and one or two seconds in a new process. Without it a call with fewer
    than 5 000 commands does not wait for the compiler, and takes some milliseconds a command.
    """
    if _loop(_PAYS) is kernel.govern_batch:
        return False
    routes = Pulleys(0.4, [[0.02], [-0.02]], 0.1)
    made = PressureGovernor(Mechanism(routes, (SAROSI_DMSP_20_400N,) * 2), 0.01, 1e6, 0.1)
    made(np.zeros(1), np.zeros(1), np.full(2, 2e5), np.full(2, 2e5))
    return True


__all__ = ["Governed", "GovernorStatus", "PressureGovernor", "warm_up"]
