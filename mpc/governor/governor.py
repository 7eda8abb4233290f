"""Governor of the pressures of a mechanism.

Loop over commands, compiled by numba from the kernel and a mechanism's formulas, or plain Python.

numba needs as much time to unpack thirty arrays as the kernel for several commands. Its numbers and memory are
therefore parts of one table, and the states and commands rows of another.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cache, cached_property
from itertools import accumulate, pairwise
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput, notice
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import Gas
from allocator.mechanism import Mechanism
from mpc.governor import kernel
from mpc.governor.model import Dynamics, Interval, Posed, Scaled, ends, rows
from mpc.governor.rules import Limits, Made, make, memory_for
from mpc.model.pressures import gas_of
from mpc.tracking.qp.step import SlowStep

if TYPE_CHECKING:
    from mpc.model.arm.model import Arm


_PLACE = "FORMULAS: Any = None\nmotion = potential = FORMULAS\n"  # of the formulas, in the kernel's text
_LOOP = '''

def govern_rows(table, counts, rows, safe, status):
    """Govern the commands in `rows` (N, 2n + 3m) of q, ω, P, the last command and the next."""
    rules = Rules({rules})
    memory = Memory({memory})
    for i in range(len(status)):
        status[i] = govern(rules, {row}, safe[i], memory)
'''
_COMPILED = """

from allocator.compilation.jit import compiled, register

register((motion, potential), inline=False, unaliased=True)  # which are long
govern_rows = compiled(govern_rows, FUNCTIONS, inline=True, unaliased=True)
"""


class Loop(NamedTuple):
    """Function that fills `safe` (N, m) and `status` (N): (table, counts, rows, safe, status) ↦ None."""

    govern: Callable[..., None]
    compiled: bool


class Packed(NamedTuple):
    """Numbers and memory of a kernel, and the text of the loop that unpacks them."""

    table: Array
    counts: NDArray[np.int64]
    text: str


def packed(formulas: str, rules: kernel.Rules, memory: kernel.Memory) -> Packed:
    """Return the table of `rules` and `memory`, and the kernel's text with the `formulas` and the loop."""
    parts: list[Array | NDArray[np.int64]] = [*rules, *memory]
    ends = [0, *accumulate(part.size for part in parts if part is not rules.counts)]
    views = iter(pairwise(ends))
    texts = ["counts" if part is rules.counts else _view("table[{}:{}]", part, *next(views)) for part in parts]
    n, m = memory.angles.size, memory.pressures.size
    states = [0, *accumulate((n, n, m, m, m))]
    row = ", ".join(f"rows[i, {begin}:{end}]" for begin, end in pairwise(states))
    given = {"rules": ", ".join(texts[: len(rules)]), "memory": ", ".join(texts[len(rules) :]), "row": row}
    table = np.concatenate([part.ravel() for part in parts if part is not rules.counts])
    head, place, rest = Path(str(kernel.__file__)).read_text(encoding="utf-8").partition(_PLACE)
    assert place
    return Packed(table, rules.counts, head + formulas + rest + _LOOP.format(**given))


def _view(text: str, part: Array | NDArray[np.int64], begin: int, end: int) -> str:
    shape = f".reshape({', '.join(map(str, part.shape))})" if part.ndim > 1 else ""
    return text.format(begin, end) + shape


@cache
def plain_loop(text: str) -> Loop:
    """Return the loop of a `Packed.text` as a Python function."""
    names: dict[str, Any] = {"__name__": "mpc.governor.kernel with formulas"}
    exec(compile(text, "mpc/governor/kernel.py with formulas", "exec"), names)
    return Loop(names["govern_rows"], False)


@cache
def compiled_loop(text: str) -> Loop:
    """Return the loop compiled at its first call; if that fails, warn with `SlowStep` and return the plain one."""
    reason = "numba is missing, or told not to compile"
    try:
        from mpc.codegen.modules import imported

        made = imported(text + _COMPILED).govern_rows
        if made is not None:
            return Loop(made, True)
    except (ImportError, OSError) as failure:  # no numba, or no writable cache
        reason = str(failure)
    notice(f"the governor is not compiled and takes about a thousand times as long: {reason}", SlowStep)
    return plain_loop(text)


_SINGULAR = 1e-12  # least eigenvalue of an inertia, relative to its greatest
_PAYS = 500  # number of commands from which compilation pays
_ROWS: dict[str, tuple[str, str, float | None]] = {  # unit, number, lower bound
    "load": ("N·m", "n", None),
    "damping": ("N·m·s/rad", "n", None),
    "lag": ("s", "m", None),
    "strength": ("-", "m", 0.0),
}
_NAMES = "q", "omega", "P", "previous", "command"


class GovernorStatus(IntEnum):
    """Outcome for a command; if several apply, the last one, with priority of BAD_INPUT."""

    SAFE = kernel.SAFE  # unchanged
    MOVED = kernel.MOVED  # moved to pressures that respect all limits
    NOT_KEPT = kernel.NOT_KEPT  # joint range or energy may not be kept: the backup, or the strongest brake
    CONFLICT = kernel.CONFLICT  # the limits of a muscle are contradictory: the supply had priority
    SLACK = kernel.SLACK  # no pressure keeps a muscle taut
    OUTSIDE_LIMITS = kernel.OUTSIDE_LIMITS  # the slew permits a muscle no pressure within the supply
    BAD_INPUT = kernel.BAD_INPUT  # a command is not a number: replaced by the muscle's previous one


_STATUS = {int(status): status for status in GovernorStatus}


class Governed(NamedTuple):
    """Safe pressures, and the outcome for each command."""

    P: Array  # (…, m) [Pa]
    status: GovernorStatus | NDArray[np.int64]  # of one command, or of each (…)


@dataclass(frozen=True)
class PressureGovernor:
    """Governor that always respects supply, slew and tautness, and the joint range if the model is right within bounds.

    A command passes if the model, under it for a sample and then under a backup that drives the arm to a stiff rest,
    stays in range until its energy proves that it always will (`mpc.governor.kernel`). The backup is then available at
    the next sample, so that on the model an arm that begins in range stays there, for any number of joints. A distance
    of 0.5° from the ends allows for the error of the integration. A command that does not pass is moved towards those
    of the backup, to the first of 16 steps that passes.

    An arm that differs from its model leaves the range by some degrees: by 10° if the damping is 20 % less. Uncertain
    values are therefore given as an `Interval`, and a command has to pass at all corners of the intervals
    (`mpc.governor.model`): strength, damping, masses (`inertia` and `gravity` together) and lag. Other values count as
    exact. The intervals are those of constants: effects that vary in time, such as hysteresis, a falling supply or
    contacts, need a `margin` or a `load`. `python -m benchmarks.governor` measures all this.

    The first call with many commands compiles, and so does `warm_up`; before, a command takes about ten milliseconds
    per corner.
    """

    mechanism: Mechanism  # or an `AntagonistJoint`, which is converted
    dt: float  # sample time [s]
    slew: float  # greatest change of a command [Pa/s]
    inertia: ArrayLike | Posed | Interval  # M (n, n) [kg·m²], its diagonal (n), a number, a function q ↦ M, or two
    gravity: Posed | Interval | None = None  # q ↦ g (n) [N·m], torques that muscles balance
    damping: ArrayLike | Interval = ()  # of the joints (n) [N·m·s/rad], or an `Interval`; by default 0
    load: tuple[float, ...] = ()  # greatest additional constant torque on each joint (n) [N·m]; by default 0
    lag: ArrayLike | Interval = 0.0  # of the pressures after the commands [s], one or m of them, or an `Interval`
    margin: float = 0.0  # distance of the joints from their ends [rad]
    min_force: float = 0.0  # that keeps a muscle taut [N]
    max_energy: float | None = None  # greatest kinetic energy [J], for a contact
    strength: ArrayLike | Interval = 1.0  # of the muscles' forces, relative to the model [-], one or m of them
    gas: Gas | bool | None = None  # that motion compresses; None, False: regulators hold the pressures

    def __post_init__(self) -> None:
        """Check the consistency of the parts. Raises `InvalidInput`."""
        given: object = self.mechanism
        mechanism = Mechanism.from_joint(given) if isinstance(given, AntagonistJoint) else given
        if not isinstance(mechanism, Mechanism):
            raise InvalidInput(f"mechanism is a {type(mechanism).__name__}; expected a Mechanism or a joint")
        object.__setattr__(self, "mechanism", mechanism)
        object.__setattr__(self, "gas", gas_of("PressureGovernor: gas", self.gas, mechanism.gas))
        n, m = self.mechanism.n, self.mechanism.m
        sizes = {"n": n, "m": m}
        for name, (unit, letter, above) in _ROWS.items():
            low, high = rows(f"PressureGovernor: {name}", getattr(self, name), unit, sizes[letter], letter, above)
            value = Interval(tuple(low.tolist()), tuple(high.tolist())) if (low < high).any() else tuple(low.tolist())
            object.__setattr__(self, name, value)
        if isinstance(self.load, Interval):
            raise InvalidInput("PressureGovernor: load is the greatest torque on each joint; expected n numbers [N·m]")
        matrices = [end if callable(end) else _inertia(end, n) for end in ends(self.inertia)]
        same = not isinstance(self.inertia, Interval) or matrices[0] == matrices[1]
        object.__setattr__(self, "inertia", matrices[0] if same else Interval(*matrices))
        if self.gas is not None and min(ends(self.lag)[0]) <= 0:
            raise InvalidInput("PressureGovernor: no motion compresses gas behind regulators without a lag; give lag")
        for end in ends(self.gravity):
            if end is not None and not callable(end):
                raise InvalidInput(
                    f"PressureGovernor: gravity = {checks.brief(end)} has to be a function of q that gives n torques "
                    "[N·m], or None"
                )
        for name, unit, least in (("dt", "s", 1e-6), ("slew", "Pa/s", 1e3), ("margin", "rad", 0.0)):
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
        self.made  # noqa: B018  # muscles and routes that cannot be governed are refused here

    @classmethod
    def of_arm(cls, arm: "Arm", dt: float, *, mass: float | Interval = 1.0, **others: Any) -> Self:
        """Return the governor of an `mpc.model.arm.model.Arm` with the arm's slew, lags, gas and bodies.

        `mass` is a factor of all its masses [-], and `others` are further fields, such as
        `damping=Interval.about(arm.bodies.damping, 0.2)`. Raises `InvalidInput`.
        """
        bodies = arm.bodies
        given: dict[str, Any] = {"slew": arm.slew, "lag": arm.lag, "damping": bodies.damping, "gas": arm.gas}
        given |= {"inertia": bodies.mass_matrix, "gravity": bodies.gravity_torque}
        low, high = rows("PressureGovernor: mass", mass, "-", 1, "1", 0.0)[:, 0].tolist()
        for name in ("inertia", "gravity") if (low, high) != (1.0, 1.0) else ():
            lightest, heaviest = Scaled(given[name], low), Scaled(given[name], high)
            given[name] = Interval(lightest, heaviest) if low < high else lightest
        return cls(arm.mechanism, dt, **(given | others))

    def __call__(
        self, q: ArrayLike, omega: ArrayLike, P: ArrayLike, command: ArrayLike, previous: ArrayLike | None = None
    ) -> Array:
        """Return safe pressures (…, m) [Pa]; arguments as in `govern`."""
        return self.govern(q, omega, P, command, previous).P

    def govern(
        self, q: ArrayLike, omega: ArrayLike, P: ArrayLike, command: ArrayLike, previous: ArrayLike | None = None
    ) -> Governed:
        """Return safe pressures next to `command` (…, m) [Pa], and the outcome.

        Parameters
        ----------
        q, omega
            Angles [rad] and rates [rad/s] of the joints (…, n).
        P
            Pressures now (…, m) [Pa].
        command
            Wanted pressures (…, m) [Pa]; any numbers, including NaN and infinite ones.
        previous
            Last commanded pressures (…, m) [Pa], from which the slew counts; by default `P`.

        Raises
        ------
        InvalidInput
            For wrong shapes, and angles, rates or pressures that are not finite.
        """
        rows = self._rows((q, omega, P, P if previous is None else previous, command))
        shape = rows.shape[:-1]
        flat = rows.reshape(-1, rows.shape[-1])
        safe, status = np.empty((len(flat), self._sizes[-1])), np.empty(len(flat), np.int64)
        self._loop(len(flat)).govern(self._table, self._packed.counts, flat, safe, status)
        if not shape:
            return Governed(safe[0], _STATUS[int(status[0])])
        return Governed(safe.reshape(*shape, -1), status.reshape(shape))

    def _rows(self, given: tuple[ArrayLike, ...]) -> Array:
        """Return rows (…, 2n + 3m) of q, ω, P, the last command and the next. Raises `InvalidInput`."""
        arrays = [np.asarray(value, float) for value in given]
        lead = arrays[0].shape[:-1]
        if [array.shape for array in arrays] != [(*lead, size) for size in self._sizes]:
            arrays = self._spread(arrays)
        rows = np.concatenate(arrays, axis=-1)
        known = rows[..., : -self._sizes[-1]]
        if not isfinite(np.add.reduce(known, axis=None)):  # in half the time of np.isfinite
            for name, array in zip(_NAMES[:4], arrays[:4], strict=True):
                if not np.isfinite(array).all():
                    raise InvalidInput(f"{name} has to be finite; only a command may be anything")
        return rows

    def _spread(self, arrays: list[Array]) -> list[Array]:
        """Return arrays with a common leading shape. Raises `InvalidInput`."""
        for name, array, size in zip(_NAMES, arrays, self._sizes, strict=True):
            if array.ndim == 0 or array.shape[-1] != size:
                raise InvalidInput(f"{name} has the shape {array.shape}; expected (…, {size})")
        try:
            shape = np.broadcast_shapes(*(array.shape[:-1] for array in arrays))
        except ValueError:
            raise InvalidInput(f"leading shapes do not broadcast: {[a.shape for a in arrays]}") from None
        return [np.broadcast_to(array, (*shape, array.shape[-1])) for array in arrays]

    def warm_up(self) -> bool:
        """Compile now, so that every later call is fast; return False, with a `SlowStep` warning, if that fails.

        It takes about ten seconds for a new kind of mechanism and bodies, and little time with code cached on disk.
        """
        made, m = compiled_loop(self._packed.text), self.mechanism.m
        rows = np.zeros((0, sum(self._sizes)))
        made.govern(self._table, self._packed.counts, rows, np.zeros((0, m)), np.zeros(0, np.int64))
        self.__dict__["_ready"] = made
        return made.compiled

    def _loop(self, commands: int) -> Loop:
        """Return the existing loop, or the compiled one if that pays."""
        if "_ready" not in self.__dict__ and commands >= _PAYS:
            self.warm_up()
        ready: Loop | None = self.__dict__.get("_ready")
        return ready or plain_loop(self._packed.text)

    @cached_property
    def made(self) -> Made:
        """Numbers and formulas of the kernel."""
        damping, lag, strength = (np.array(ends(value)) for value in (self.damping, self.lag, self.strength))
        inertia, gravity = ends(self.inertia), ends(self.gravity)
        gas = gas_of("gas", self.gas, self.mechanism.gas)
        dynamics = Dynamics(self.mechanism, inertia, gravity, damping, strength, np.array(self.load), gas)
        limits = Limits(self.dt, self.slew, lag, self.margin, self.min_force, self.max_energy)
        return make(dynamics, limits)

    @cached_property
    def _packed(self) -> Packed:
        return packed(self.made.text, self.made.rules, memory_for(self.made.rules))

    @cached_property
    def _sizes(self) -> tuple[int, ...]:
        n, m = self.mechanism.n, self.mechanism.m
        return n, n, m, m, m

    @cached_property
    def _kept(self) -> threading.local:
        return threading.local()

    @property
    def _table(self) -> Array:
        """Kernel's numbers and memory, one table per thread."""
        kept: dict[str, Array] = self._kept.__dict__
        if "table" not in kept:
            kept["table"] = self._packed.table.copy()
        return kept["table"]

    def __getstate__(self) -> dict[str, object]:
        """Return only the fields; another process rebuilds everything else."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def _inertia(value: ArrayLike, n: int) -> tuple[tuple[float, ...], ...]:
    """Return M (n, n) from a number, a diagonal (n) or a matrix (n, n). Raises `InvalidInput`."""
    array = checks.real("PressureGovernor: inertia", value, "kg·m²")
    wrong = f"PressureGovernor: inertia has to be M ({n}, {n}), positive definite, its diagonal or a number [kg·m²]"
    if array.shape not in ((), (n,), (n, n)):
        raise InvalidInput(wrong)
    matrix = array if array.ndim == 2 else np.diag(np.broadcast_to(array, n))
    sizes = np.linalg.eigvalsh(matrix)
    if not np.allclose(matrix, matrix.T) or not sizes.min() > _SINGULAR * sizes.max():
        raise InvalidInput(wrong)
    return tuple(map(tuple, matrix.tolist()))
