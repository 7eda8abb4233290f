"""A learner: the corrections of one motion from repetition to repetition, and when to stop."""

from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import DEG
from mpc.repetition.response import Response
from mpc.repetition.update import Update, designed, power_of, unforeseen
from mpc.trials.reference import Reference
from mpc.trials.trajectories import min_jerk

NOISE = 0.03  # relative change of an RMS error that is none
PATIENCE = 3  # repetitions in a row that gain nothing
GROWTH = 2  # repetitions in a row that grow
AHEAD = 4  # repetitions that an update is designed for, the last one among them
_LEAST_GROWTH = 0.5  # of the power of the best error: more is growth, however little returns
FADE = 0.25  # [s] in which a correction sets in where the reference has no first rest
_LEAST_OF_SEVERAL = 1.5  # times the least of several estimated powers is an estimate again
_MOVED = 1e-9  # [rad] and relative stiffness


class Reason(Enum):
    """Reason why learning has ended."""

    RUNNING = "it goes on"
    ENOUGH = "all repetitions that were asked for are done"
    SETTLED = f"{PATIENCE} repetitions in a row gained less than {100 * NOISE:.0f} %"
    GREW = f"the error grew {GROWTH} times in a row, the second time with half the gain"
    UNKNOWN = "no update is guaranteed to lessen the error"


class Repetition(NamedTuple):
    """One repetition of a motion."""

    rms: float  # error after the first rest, over all joints [rad]
    worst: float  # [rad]
    correction: Array  # (M, …) [rad] that it was done with
    gain: float  # of the update that made that; 0 of the first


@dataclass(frozen=True, eq=False)
class Course:
    """Samples of a motion: those in which it counts and those that a correction sets in with."""

    wanted: Reference  # resampled
    count: int  # samples before the tail
    begin: int  # first sample that counts
    fade: Array  # (count,) from 0 to 1

    @classmethod
    def of(cls, reference: Reference, dt: float) -> Self:
        """Return the course of a reference with samples of `dt` [s]."""
        wanted = reference.resampled(dt)
        count = wanted.samples(dt) + 1
        theta, K = (a[:count].reshape(count, -1) for a in (wanted.theta, wanted.K))
        away = (np.abs(theta - theta[0]) > _MOVED).any(axis=1) | (np.abs(K / K[0, 0] - K[0] / K[0, 0]) > _MOVED).any(1)
        begin = max(int(np.argmax(away)) - 1, 0)
        t, rest = dt * np.arange(count), dt * begin
        return cls(wanted, count, begin, min_jerk(np.asarray((t - rest / 2) / max(rest / 4, FADE), float)))


class Learner:
    """Learning of the correction of one motion, see `mpc.repetition.update`.

    `reference` is what the controller is to be given next; after each repetition call `learn` with the angles that were
    measured. The first repetition is done without a correction, or with a given one. The update is designed anew after
    each repetition, with what has turned out not to return as noise. If the error grows by more than that, the next
    repetition returns to the best correction and takes half the gain from it; after the second growth in a row, and
    after three repetitions in a row without gain, learning is `done`, and `reason` is why. `best` is the best
    repetition, and `update` the first one.

    Parameters
    ----------
    reference
        Angles that are wanted [rad], with their stiffness, which stays as it is.
    responses
        Responses that the loop may have, see `mpc.repetition.response`.
    dt
        Sample time of the controller [s].
    repetitions
        At most, 2 or more.
    correction
        To begin with, (M, …) [rad] on the samples of the reference every `dt`.
    angle_limits
        Of the joints [rad]; no corrected reference leaves them where the reference does not.
    """

    def __init__(
        self,
        reference: Reference,
        responses: tuple[Response, ...],
        dt: float,
        repetitions: int = 8,
        *,
        correction: Array | None = None,
        angle_limits: tuple[Array | float, Array | float] = (-np.inf, np.inf),
    ) -> None:
        self.repetitions = checks.count("repetitions", repetitions, least=2)
        self.dt, self.course, self._responses = dt, Course.of(reference, dt), responses
        self._low, self._high = angle_limits
        shape = self.course.wanted.theta.shape
        self._next = np.zeros(shape) if correction is None else checks.real("correction", correction, "rad").copy()
        if self._next.shape != shape:
            raise InvalidInput(f"correction has the shape {self._next.shape}, the samples of the reference {shape}")
        self.history: list[Repetition] = []
        self.update: Update | None = None
        self.reason = Reason.RUNNING
        self._now: Update | None = None
        self._best, self._base, self._grown, self._idle, self._caution = 0, 0, 0, 0, 1.0
        self._errors: list[Array] = []
        self._noises: list[Array] = []  # powers (f,) of what did not return

    @property
    def done(self) -> bool:
        """Whether learning has ended."""
        return self.reason is not Reason.RUNNING

    @property
    def best(self) -> Repetition:
        """The best repetition so far. Raises `InvalidInput` before the first."""
        if not self.history:
            raise InvalidInput("nothing was learned yet: there was no repetition")
        return self.history[self._best]

    @property
    def gain(self) -> float:
        """Error of the first repetition over that of the best one [-]."""
        return self.history[0].rms / self.best.rms if self.best.rms else 1.0

    @property
    def reference(self) -> Reference:
        """Reference to give to the controller next: that of the next repetition, or of the best one at the end."""
        return self.corrected(self.best.correction if self.done else self._next)

    def corrected(self, correction: Array) -> Reference:
        """Return the reference with a `correction` (M, …) [rad]."""
        wanted = self.course.wanted.theta
        low, high = np.minimum(self._low, wanted), np.maximum(self._high, wanted)
        return replace(self.course.wanted, theta=np.clip(wanted + correction, low, high))

    def learn(self, theta: Array) -> Repetition:
        """Take in the measured angles (count, …) [rad] of a repetition at the samples of the reference; return it.

        Raises `InvalidInput` for angles of another shape, or after the end.
        """
        if self.done:
            raise InvalidInput(f"learning has ended: {self.reason.value}")
        error = self.course.wanted.theta[: self.course.count] - checks.real("theta", theta, "rad")
        counted = error[self.course.begin :]
        rms, worst = float(np.sqrt(np.mean(counted**2))), float(np.abs(counted).max())
        self.history.append(Repetition(rms, worst, self._next, 0.0 if self._now is None else self._now.gain))
        self._errors.append(error)
        if len(self.history) > 1:
            self._judge(rms)
        if self.reason is Reason.RUNNING and len(self.history) == self.repetitions:
            self.reason = Reason.ENOUGH
        if not self.done:
            self._design()
        if not self.done:
            self._next = self._updated()
        return self.history[-1]

    def _judge(self, rms: float) -> None:
        """Compare the last repetition with the best before, and end if several in a row gained nothing or grew."""
        last, before, model = len(self.history) - 1, self.best.rms, self._responses[0]
        change = self.history[last].correction - self.history[self._base].correction
        old, new, shift = map(self._counted, (self._errors[self._base], self._errors[last], change))
        self._noises.append(unforeseen(model, old, new, shift, self.dt))
        share = self._noise.sum() / max(power_of(new, model, self.dt), 1e-300)
        doubt = min(share * rms**2, _LEAST_GROWTH * before**2)
        if rms < before:
            self._best = last
        if rms**2 > ((1 + NOISE) * before) ** 2 + doubt:
            self._grown, self._caution, self._base = self._grown + 1, self._caution / 2, self._best
            self._noises.pop()  # an error that grows is the update's fault until it is shown not to be
        else:
            self._grown, self._base = 0, last
        self._idle = self._idle + 1 if rms > (1 - NOISE) * before else 0
        if self._grown == GROWTH:
            self.reason = Reason.GREW
        elif self._idle == PATIENCE:
            self.reason = Reason.SETTLED

    @property
    def _noise(self) -> Array:
        """Power (f,) of what did not return: the least of all repetitions, since a wrong response adds to each."""
        return np.asarray(np.minimum(_LEAST_OF_SEVERAL * np.min(self._noises, axis=0), self._noises[-1]))

    def _counted(self, values: Array) -> Array:
        """Return the part (M, n) of `values` in which the motion counts."""
        part = values[self.course.begin : self.course.count]
        return part.reshape(len(part), -1)

    def _design(self) -> None:
        shown = self.course.fade[self.course.begin] if self.course.begin else 1.0
        error = shown * self._counted(self._errors[self._base])
        noise: Array | float = self._noise if self._noises else 0.0
        ahead = self.repetitions if self.update is None else AHEAD
        try:
            update = designed(self._responses, error, self.dt, ahead, noise, self.update)
        except InvalidInput:
            self.reason = Reason.UNKNOWN
            return
        self.update = self.update or update
        self._now = replace(update, gain=self._caution * update.gain)

    def _updated(self) -> Array:
        """Return the next correction; the tail, in which no error is known, goes on with the last one."""
        assert self._now is not None
        size, count = self._next.shape[0], self.course.count
        faded = self._errors[self._base].reshape(count, -1) * self.course.fade[:, None]
        error = np.concatenate([faded, np.tile(faded[-1], (size - count, 1))])
        base = self.history[self._base].correction
        corrected = self._now.applied(base.reshape(size, -1), error, self.dt)
        fade = np.ones(size)
        fade[:count] = self.course.fade
        return np.asarray((corrected * fade[:, None]).reshape(self._next.shape))

    def __str__(self) -> str:
        """Return what was gained, and why it ended."""
        if not self.history:
            return "no repetition yet"
        first, best = self.history[0].rms / DEG, self.best.rms / DEG
        by = f"{first:.3g}° → {best:.3g}° RMS in repetition {self._best + 1} of {len(self.history)}"
        return f"{by}, {self.gain:.1f} times less; {self.reason.value}"
