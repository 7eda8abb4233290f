"""Plans: the controller's answer at every sample.

Each status has one origin: `BAD_INPUT` and `BLIND` from the inputs (`mpc.tracking.preview.Task.halted`), `RESTING` from
the rest mode (`mpc.tracking.rest`), `OPTIMAL`, `UNSOLVED` and `REFUSED` from the QP's proof
(`mpc.tracking.qp.step`), `LATE` from the clock; `status_of` combines them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Self

from allocator.calculus import Array
from allocator.units import BAR


class Deferred:
    """Object that computes its deferred attributes on first access, so a control step does not pay for unread ones."""

    _put_off: ClassVar[tuple[str, ...]] = ()  # names of the deferred attributes

    def defer(self, fill: Callable[..., None], *values: object) -> None:
        """Have `fill(self, *values)` set the deferred attributes on first access."""
        for name in self._put_off:
            self.__dict__.pop(name, None)
        self.__dict__["_fill"] = fill, values

    def catch_up(self) -> None:
        """Set the deferred attributes now if they are pending."""
        if (deferred := self.__dict__.pop("_fill", None)) is not None:
            fill, values = deferred
            fill(self, *values)

    if not TYPE_CHECKING:  # for type checkers every misspelt attribute would exist

        def __getattr__(self, name: str) -> object:
            """Set the deferred attributes and return the named one. Raises `AttributeError` for unknown names."""
            if "_fill" not in self.__dict__:
                raise AttributeError(f"a {type(self).__name__} has no {name!r}", name=name, obj=self)
            self.catch_up()
            return getattr(self, name)

    def __getstate__(self) -> dict[str, object]:
        self.catch_up()
        return self.__dict__.copy()


class Rung(IntEnum):
    """Rung of the fallback ladder that produced the plan, best first."""

    QP = 0
    SOFTENED = 1
    PREVIOUS = 2
    ALLOCATION = 3
    HOLD = 4

    @property
    def text(self) -> str:
        """Description of this rung."""
        return _RUNGS[self]


_RUNGS = {
    Rung.QP: "solved the optimisation problem",
    Rung.SOFTENED: "took commands within slew and supply that are not proved optimal",
    Rung.PREVIOUS: "went on with the previous plan",
    Rung.ALLOCATION: "commanded the closed-form allocation",
    Rung.HOLD: "held the pressures, and vents them slowly if this lasts",
}


class PlanStatus(IntEnum):
    """Status of a plan."""

    BAD_INPUT = -1
    OPTIMAL = 0
    UNSOLVED = 1
    REFUSED = 2
    NO_MEASUREMENT = 3
    NOT_FINITE = 4
    CLOSED_FORM = 5
    LATE = 6
    BLIND = 7
    RESTING = 9

    @property
    def text(self) -> str:
        """One sentence with advice."""
        return _STATUSES[self]


_STATUSES = {
    PlanStatus.BAD_INPUT: "A reference or the torque d is not plausible; the pressures are held.",
    PlanStatus.OPTIMAL: "The problem was solved and its optimality conditions were checked.",
    PlanStatus.UNSOLVED: "The solver gave up; try another solver.",
    PlanStatus.REFUSED: "The solver's answer is not optimal and was refused; try another solver.",
    PlanStatus.NO_MEASUREMENT: "The measured state is not finite; the predicted one was used in its place.",
    PlanStatus.NOT_FINITE: "The prediction left the range of numbers; check the state and the plant's parameters.",
    PlanStatus.CLOSED_FORM: "This controller does not optimise: its commands are in closed form.",
    PlanStatus.LATE: "The problem was not solved within the time budget; shorten the horizon or block moves.",
    PlanStatus.BLIND: "The angle has not been measured for too long to trust its prediction; check the sensor.",
    PlanStatus.RESTING: "The reference stands still: the pressures are held, and corrected now and then.",
}


class Moved(NamedTuple):
    """Greatest distance over the horizon between the references and the nearest feasible ones."""

    theta: float  # [rad]
    K: float  # [N·m/rad]
    T: float  # [N·m], torque that the motion needs beyond that of the muscles


class Times(NamedTuple):
    """Durations of the stages of a step [s]; 0.0 for stages that were not needed."""

    feed_forward: float
    linearise: float
    condense: float
    solve: float
    total: float


@dataclass(frozen=True, eq=False)
class Plan(Deferred):
    """Commands for the horizon and the predicted motion; time is the first axis. Read-only."""

    u: Array  # (N, 2) commanded pressures [Pa], within the supply and the slew limit; u[0] is the one to send now
    x: Array  # (N+1, 4) states of the plant model from the time at which u[0] acts
    K: Array  # (N+1,) stiffness along x [N·m/rad]
    status: PlanStatus
    rung: Rung
    slack: float  # s: greatest excursion of x from the joint range [rad]
    times: Times
    # defaults by factories leave no class attribute that would hide `__getattr__`
    slack_force: float = field(
        default_factory=float
    )  # s_F: greatest shortfall of a force below the least one along x [N]
    moved: Moved | None = field(default_factory=lambda: None)  # None if the controller does not report it
    gap: float = field(default_factory=float)  # bound of the cost of u minus that of the QP's solution; inf: unknown

    def __post_init__(self) -> None:
        """Make the arrays read-only, because the controller continues from them."""
        for array in (self.u, self.x, self.K):
            array.setflags(write=False)

    def __repr__(self) -> str:
        first = ", ".join(f"{P / BAR:.4g}" for P in self.u[0])
        return f"Plan: {self.status.name} by {self.rung.name}, {len(self.u)} samples, first commands {first} bar"

    @classmethod
    def later(cls, fields: Callable[..., dict[str, object]], *values: object) -> Self:
        """Return a plan of the fields `fields(*values)`, computed on first access to one of them."""
        plan = object.__new__(cls)
        plan.__dict__["_fill"] = _fill, (fields, values)
        return plan


def _fill(plan: Plan, fields: Callable[..., dict[str, object]], values: tuple[object, ...]) -> None:
    plan.__dict__.update(fields(*values))
    plan.__post_init__()


def status_of(optimised: PlanStatus, rung: Rung, measured: bool) -> PlanStatus:
    """Return the status of a plan on `rung` after an optimisation with the status `optimised`."""
    if optimised is not PlanStatus.OPTIMAL:
        return optimised
    if rung is not Rung.QP:
        return PlanStatus.NOT_FINITE  # the motion under the QP's commands
    return PlanStatus.OPTIMAL if measured else PlanStatus.NO_MEASUREMENT
