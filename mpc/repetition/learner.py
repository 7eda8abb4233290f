"""Learner of the correction of one motion, with its stopping rules."""

from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import DEG
from mpc.repetition.response import Response
from mpc.repetition.update import Update, designed, passed, power_of, rested, returning, unforeseen
from mpc.trials.motions.reference import Reference, min_jerk

NOISE = 0.03  # relative change of an RMS error below which it counts as unchanged
PATIENCE = 3  # repetitions in a row without gain, after which learning ends
GROWTH = 2  # repetitions in a row with growth, after which learning ends
_LEAST_GROWTH = 0.5  # of the power of the best error: a greater increase is growth at any noise
FADE = 0.25  # [s] over which a correction sets in if the reference has no first rest
_LEAST_REST = 1.0  # [s] of a rest from which noise is estimated
_LEAST_OF_SEVERAL = 1.5  # corrects the bias of the least of several estimated powers
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
    correction: Array  # (M, …) [rad] during this repetition
    gain: float  # of the update before this repetition; 0 for the first


@dataclass(frozen=True, eq=False)
class Course:
    """Samples of a motion, the first one that counts, and the fade-in of a correction."""

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
    """Learner of the correction of one motion, see `mpc.repetition.update`.

    Give `reference` to the controller, then call `learn` with the measured angles of the repetition, until `done`;
    `reason` states why it has ended. The first repetition is uncorrected unless a correction is given. After it the
    update is designed; each later one filters out errors that do not return. If the error grows by more
    than noise, the next repetition starts again from the best correction with half the gain. Learning ends after two
    repetitions in a row with growth, or three without gain.

    Parameters
    ----------
    reference
        Desired angles [rad] and stiffness; the stiffness is not corrected.
    responses
        Possible responses of the loop, see `mpc.repetition.response`.
    dt
        Sample time of the controller [s].
    repetitions
        Most repetitions, 2 or more.
    correction
        Correction of the first repetition, (M, …) [rad] on the samples of the reference every `dt`.
    angle_limits
        Angle limits of the joints [rad]. A corrected reference is clipped to them where the reference keeps to them.
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
        self._best, self._base, self._grown, self._idle, self._caution, self._gain = 0, 0, 0, 0, 1.0, 0.0
        self._errors: list[Array] = []
        self._noises: list[Array] = []  # powers (f,) of errors that did not return

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
        """Reference of the next repetition, or of the best one if learning is `done`."""
        return self.corrected(self.best.correction if self.done else self._next)

    def corrected(self, correction: Array) -> Reference:
        """Return the reference with a `correction` (M, …) [rad]."""
        wanted = self.course.wanted.theta
        low, high = np.minimum(self._low, wanted), np.maximum(self._high, wanted)
        return replace(self.course.wanted, theta=np.clip(wanted + correction, low, high))

    def learn(self, theta: Array) -> Repetition:
        """Learn from the measured angles (count, …) [rad] of a repetition at the samples of the reference; return it.

        Raises `InvalidInput` for angles of another shape, or if learning is `done`.
        """
        if self.done:
            raise InvalidInput(f"learning has ended: {self.reason.value}")
        error = self.course.wanted.theta[: self.course.count] - checks.real("theta", theta, "rad")
        counted = error[self.course.begin :]
        rms, worst = float(np.sqrt(np.mean(counted**2))), float(np.abs(counted).max())
        self.history.append(Repetition(rms, worst, self._next, self._gain))
        self._errors.append(error)
        if len(self.history) > 1:
            self._judge(rms)
        if self.reason is Reason.RUNNING and len(self.history) == self.repetitions:
            self.reason = Reason.ENOUGH
        if not self.done and self.update is None:
            self._design()
        if not self.done:
            self._next = self._updated()
        return self.history[-1]

    def _judge(self, rms: float) -> None:
        """Compare the last repetition with the best one so far; end after several without gain, or with growth."""
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
            self._noises.pop()  # growth is attributed to the update, not to noise
        else:
            self._grown, self._base = 0, last
        self._idle = self._idle + 1 if rms > (1 - NOISE) * before else 0
        if self._grown == GROWTH:
            self.reason = Reason.GREW
        elif self._idle == PATIENCE:
            self.reason = Reason.SETTLED

    @property
    def _noise(self) -> Array:
        """Power (f,) of the errors that do not return.

        It is the least of all repetitions, since a wrong response adds to each. Before the second repetition it is that
        of the second half of the first rest.
        """
        if self._noises:
            return np.asarray(np.minimum(_LEAST_OF_SEVERAL * np.min(self._noises, axis=0), self._noises[-1]))
        begin = self.course.begin
        rest = self._errors[0][begin // 2 : begin]
        if len(rest) < _LEAST_REST / self.dt:
            return np.zeros(self._responses[0].frequency.size)
        rest = rest.reshape(len(rest), -1)
        return rested(rest, self._responses[0], self.dt, self.course.count - begin)

    def _counted(self, values: Array) -> Array:
        """Return the samples (M, n) of `values` that count."""
        part = values[self.course.begin : self.course.count]
        return part.reshape(len(part), -1)

    def _design(self) -> None:
        """Design the update after the first repetition."""
        shown = self.course.fade[self.course.begin] if self.course.begin else 1.0
        error = shown * self._counted(self._errors[0])
        try:
            self.update = designed(self._responses, error, self.dt, self.repetitions)
        except InvalidInput:
            self.reason = Reason.UNKNOWN

    def _updated(self) -> Array:
        """Return the next correction; the last error is held in the tail, where no error is known."""
        assert self.update is not None
        size, count, model = self._next.shape[0], self.course.count, self._responses[0]
        H = returning(self._counted(self._errors[self._base]), model, self.dt, self._noise)
        faded = self._errors[self._base].reshape(count, -1) * self.course.fade[:, None]
        faded = passed(faded, model.frequency, H, self.dt)
        error = np.concatenate([faded, np.tile(faded[-1], (size - count, 1))])
        base = self.history[self._base].correction
        self._gain = self._caution * self.update.gain
        corrected = replace(self.update, gain=self._gain).applied(base.reshape(size, -1), error, self.dt)
        fade = np.ones(size)
        fade[:count] = self.course.fade
        return np.asarray((corrected * fade[:, None]).reshape(self._next.shape))

    def __str__(self) -> str:
        """Return the gain, and the reason of the end."""
        if not self.history:
            return "no repetition yet"
        first, best = self.history[0].rms / DEG, self.best.rms / DEG
        by = f"{first:.3g}° → {best:.3g}° RMS in repetition {self._best + 1} of {len(self.history)}"
        return f"{by}, {self.gain:.1f} times less; {self.reason.value}"
