"""Measured forces, detection of mistakes in them, and thinning of long logs."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.outliers import outlying, some
from allocator.units import BAR

_COLUMNS = ("contraction", "pressure", "force", "weights", "scatter", "direction", "file")
_MOST_CONTRACTION = 0.6  # [-] no muscle of this family contracts further
_MOST_STRETCH = -0.25  # [-]
_NOT_CONTRACTED, _FAR_STRETCHED = 0.01, -0.05  # [-]
_ZERO_PRESSURE = 0.05 * BAR  # [Pa] offset of a sensor
_SLACK = 3.0  # times the zero noise: forces indistinguishable from zero
_FAR = 40.0  # standard deviations, beyond any normal variable
_ATMOSPHERE = (0.95 * BAR, 1.10 * BAR)  # [Pa] reading of an absolute sensor on an empty muscle
MOST_ROWS = 2000  # longer logs are averaged over cells
_CELLS = (64, 32)  # of contraction, of pressure


@dataclass(frozen=True)
class Samples:
    """Samples of n measured forces; arrays [n], read-only.

    A force indistinguishable from zero means slack.
    """

    contraction: Array  # ε [-]
    pressure: Array  # P, gauge [Pa]
    force: Array  # F [N]
    weights: Array  # of the squared residuals, relative [-]
    dropped: Mapping[str, int] = field(default_factory=dict)  # numbers of samples left out, by reason
    zero_noise: float = 0.0  # standard deviation of the readings at no force [N]
    cut: bool = False  # whether the cell cuts its readings off at zero
    zero_seen: bool = False  # whether slack readings determine the cell's zero
    scatter: Array | None = None  # standard deviation [N] of the readings averaged in a sample; None: single readings
    notes: tuple[str, ...] = ()  # corrections of the readings
    direction: Array | None = None  # +1 if the varied quantity rises, -1 if it falls; None if unknown
    file: NDArray[np.intp] | None = None  # index of the file in `files`; None for a single file
    files: tuple[str, ...] = ()

    @classmethod
    def checked(
        cls,
        contraction: ArrayLike,
        pressure: ArrayLike,
        force: ArrayLike,
        weights: ArrayLike | None = None,
        file: ArrayLike | None = None,
    ) -> Self:
        """Return checked samples from array-like data, with the label of each one's file if there are several.

        Raises `InvalidInput` unless they can be a muscle's forces in SI units.
        """
        eps, P = checks.real("contraction", contraction, "ratio"), checks.pressure("pressure", pressure)
        F = checks.real("force", force, "N")
        w = checks.real("weights", np.ones_like(F) if weights is None else weights, "relative")
        if (w < 0).any():
            raise InvalidInput(f"weights{checks.at(w, w < 0)} has to be at least 0")
        arrays = checks.broadcast(contraction=eps, pressure=P, force=F, weights=w)
        eps, P, F, w = (_frozen(array) for array in arrays)
        if mistake := find_mistake(eps, P, F):
            raise InvalidInput(f"sample {mistake.place}: {mistake.sentence}")
        if file is None:
            return cls(eps, P, F, w)
        if (labels := np.asarray(file).ravel()).size != F.size:
            raise InvalidInput(f"file has {labels.size} labels for {F.size} samples")
        names, index = np.unique(labels, return_inverse=True)
        return cls(eps, P, F, w, file=index.ravel(), files=tuple(map(str, names)))

    @property
    def n(self) -> int:
        """Return the number of samples."""
        return self.force.size

    @property
    def full_scale(self) -> float:
        """Return the greatest force [N]."""
        return float(self.force.max())

    @property
    def slack(self) -> Mask:
        """Return which forces (n,) are indistinguishable from zero."""
        return np.asarray(self.force <= self.slack_limit)

    @property
    def slack_limit(self) -> float:
        """Return three times the zero noise [N], the greatest force indistinguishable from zero."""
        return _SLACK * self.zero_noise

    def residual(self, F: Array, slack: Mask) -> Array:
        """Return the residuals of the model's forces F (n,) [N] from the readings y.

        A taut sample is an equation, F - y. A slack one is one-sided: the cell shows max(F, 0) and noise, hence max(F,
        0) - y, which is independent of a slack model. The two differ only where F < 0, so a threshold between them from
        noisy readings does not bias the model. A reading far below zero means only "slack". The mean reading of a cell
        that cuts off at zero is that of a censored normal variable, F Φ(F/σ) + σ φ(F/σ) (Tobin, Econometrica 26:24-36,
        1958).
        """
        pull = np.maximum(F, 0.0)
        if self.censored:
            z = np.minimum(pull / self.zero_noise, _FAR)
            pull = pull * _normal(z) + self.zero_noise * np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
        return np.asarray(np.where(slack, pull - self.floored, F - self.force))

    def residual_slope(self, F: Array, slack: Mask) -> Array:
        """Return the derivative (n,) of the residual with respect to F."""
        pulls = np.asarray(F > 0, float)
        if self.censored:
            pulls *= _normal(np.minimum(F / self.zero_noise, _FAR))
        return np.asarray(np.where(slack, pulls, 1.0))

    @property
    def floored(self) -> Array:
        """Return the readings (n,) [N], at least three times the zero noise below zero."""
        return np.maximum(self.force, -self.slack_limit)

    @property
    def censored(self) -> bool:
        """Return whether the zero noise is cut off at zero."""
        return self.cut and self.zero_noise > 0

    def where(self, keep: Mask) -> Self:
        """Return the samples marked in `keep`."""
        columns = {name: getattr(self, name) for name in _COLUMNS}
        kept: dict[str, Any] = {name: _frozen(a[keep]) for name, a in columns.items() if a is not None}
        return replace(self, **kept)

    @property
    def parts(self) -> dict[str, Self]:
        """The samples of each file that has any, by its name; "" if there is one file."""
        if self.file is None:
            return {"": self}
        each = {name: self.where(self.file == i) for i, name in enumerate(self.files)}
        return {
            name: replace(
                part, file=None, files=(), dropped={}, notes=(),
                direction=part.direction if part.direction is not None and part.direction.any() else None,
            )
            for name, part in each.items()
            if part.n
        }  # fmt: skip

    def noted(self, note: str) -> Self:
        """Return these samples with one more note."""
        return replace(self, notes=(*self.notes, note))

    def without_outliers(self) -> Self:
        """Return the samples without outliers among their neighbours' forces, which are listed."""
        apart = outlying(np.stack([self.contraction, self.pressure], axis=1), self.force)
        shown = [
            f"{F:.4g} N at {eps:.3g} and {P / BAR:.3g} bar"
            for F, eps, P in zip(self.force[apart], self.contraction[apart], self.pressure[apart], strict=True)
        ]
        return self.without(apart, f"force apart from those at like contractions and pressures: {some(shown)}")

    def without(self, drop: Mask, reason: str) -> Self:
        """Return the samples not in the mask `drop`, and record the number dropped under `reason`."""
        if not drop.any():
            return self
        return replace(self.where(~drop), dropped={**self.dropped, reason: int(drop.sum())})


def joined(parts: Mapping[str, Samples]) -> Samples:
    """Return the samples of several files, by their names, as one.

    The zero noise is the greatest of them, the load cell cuts off its readings if it does in all, and directions are
    dropped. Notes and reasons name their file.
    """
    if len(parts) == 1:
        return next(iter(parts.values()))
    each = tuple(parts.values())
    eps, P, F, w = (
        _frozen(np.concatenate([getattr(part, name) for part in each]))
        for name in ("contraction", "pressure", "force", "weights")
    )
    return Samples(
        eps, P, F, w,
        dropped={f"{name}: {reason}": n for name, part in parts.items() for reason, n in part.dropped.items()},
        zero_noise=max(part.zero_noise for part in each),
        cut=all(part.cut for part in each),
        zero_seen=all(part.zero_seen for part in each),
        notes=tuple(f"{name}: {note}" for name, part in parts.items() for note in part.notes),
        direction=_frozen(np.concatenate([np.zeros(p.n) if p.direction is None else p.direction for p in each])),
        file=np.repeat(np.arange(len(each)), [part.n for part in each]),
        files=tuple(parts),
    )  # fmt: skip


def _normal(z: Array) -> Array:
    from scipy.special import ndtr

    return np.asarray(ndtr(z))


def _frozen(array: Array) -> Array:
    array = np.array(array).ravel()
    array.flags.writeable = False
    return array


class Mistake(NamedTuple):
    """Implausible sample."""

    place: int  # index of the sample
    quantity: str  # "contraction", "pressure" or "force"
    sentence: str


def find_mistake(contraction: Array, pressure: Array, force: Array) -> Mistake | None:
    """Return the first sign of percent instead of ratio, extension instead of contraction, or absolute pressure.

    The rules on pressure: a muscle without pressure pulls only when stretched. So the pressure is not gauge

    * if any is below -0.05 bar;
    * if at |P| ≤ 0.05 bar a muscle that is contracted (ε > 0) pulls with more than 5 % of the greatest force;
    * if none is below 0.95 bar, and at the lowest, up to 1.10 bar, a muscle at its rest length (|ε| ≤ 0.01) does not
      pull (at 1 bar gauge it would, with some 20 % of its force at 5 bar).

    Forces of a stretched muscle at 0 bar are real and pass.
    """
    force = tension(contraction, pressure, force)
    return (
        _contraction_mistake(contraction)
        or _extension_mistake(contraction, force)
        or _pressure_mistake(contraction, pressure, force)
    )


def tension(contraction: Array, pressure: Array, force: Array) -> Array:
    """Return the forces with tension positive: the other sign if the greatest are negative and fall as pressure rises.

    At one pressure it is the other sign if they rise with contraction.
    """
    if not force.size or -force.min() <= force.max():
        return force
    parts = [(q - q.min()) / max(float(np.ptp(q)), 1e-300) for q in (contraction, pressure)]
    plane = np.stack([np.ones(force.size), *parts], axis=1)
    _, contracted, rise = np.linalg.lstsq(plane, force, rcond=None)[0]  # [N] over the two ranges
    if not np.ptp(pressure) > 0:
        rise = -contracted
    return -force if rise < 1e-3 * force.min() else force


def _contraction_mistake(eps: Array) -> Mistake | None:
    wrong = (eps > _MOST_CONTRACTION) | (eps < _MOST_STRETCH)
    if not wrong.any():
        return None
    i = int(np.argmax(wrong))
    percent = np.abs(eps).max() > 1
    hint = "was percent meant for the ratio (l0 - l)/l0?" if percent else "is the rest length right?"
    return Mistake(i, "contraction", f"a contraction ratio of {eps[i]:.4g} is beyond any pneumatic muscle; {hint}")


def _extension_mistake(eps: Array, F: Array) -> Mistake | None:
    """Return the mistake of readings never contracted, often far stretched, and weaker with more stretch."""
    if not eps.size or eps.max() > _NOT_CONTRACTED or eps.min() > _FAR_STRETCHED:
        return None
    if (F - F.mean()) @ (eps - eps.mean()) <= 0:
        return None
    sentence = "the force falls as the muscle is stretched; is it contraction, (l0 - l)/l0, with the wrong sign?"
    return Mistake(int(np.argmin(eps)), "contraction", sentence)


def _pressure_mistake(eps: Array, P: Array, F: Array) -> Mistake | None:
    if (below := -_ZERO_PRESSURE > P).any():
        i = int(np.argmax(below))
        return Mistake(i, "pressure", f"{P[i] / BAR:.4g} bar is below the atmosphere; gauge pressure is expected")
    greatest = F.max(initial=0.0)
    pulls = (np.abs(P) <= _ZERO_PRESSURE) & (eps > 1e-9) & (F > 0.05 * greatest)
    if pulls.any():
        i = int(np.argmax(pulls))
        return Mistake(
            i,
            "pressure",
            f"a force of {F[i]:.4g} N at {P[i] / BAR:.4g} bar and the contraction {eps[i]:.4g}: without pressure a "
            "muscle pulls only when stretched; is the pressure absolute, or its zero or the rest length wrong?",
        )
    lowest = P.min(initial=np.inf)
    empty = (P < lowest + _ZERO_PRESSURE) & (np.abs(eps) <= 0.01)
    if not (greatest > 0 and empty.any()):
        return None
    if _ATMOSPHERE[0] <= lowest <= _ATMOSPHERE[1] and (F[empty] <= 0.02 * greatest).all():
        return Mistake(
            int(np.argmax(empty)),
            "pressure",
            f"no force at {lowest / BAR:.4g} bar, the lowest pressure, and at the rest length: the pressure looks "
            "absolute; subtract the atmosphere (about 1.013 bar), or leave these rows out if it is a gauge pressure",
        )
    return None


def thinned(samples: Samples) -> Samples:
    """Return means over cells, with a note, if there are more than 2000 rows.

    A cell is 1/64 of the range of contractions times 1/32 of that of pressures, loading and unloading together. Its
    weight is that of its rows, at most that of the median cell: a resting log adds no information. Neighbouring rows
    are correlated, so a cell counts as one reading. The scatter of its rows beyond the slope of the force is kept for
    the variance of the parameters.
    """
    if samples.n <= MOST_ROWS:
        return samples
    rows = samples.where(samples.weights > 0)
    places = [
        np.minimum((q - q.min()) / max(float(np.ptp(q)), 1e-300) * parts, parts - 1).astype(np.intp)
        for q, parts in zip((rows.contraction, rows.pressure), _CELLS, strict=True)
    ]
    file = np.zeros(rows.n, np.intp) if rows.file is None else rows.file
    _, first, cell = np.unique(
        (file * _CELLS[0] + places[0]) * _CELLS[1] + places[1], return_index=True, return_inverse=True
    )
    total = np.bincount(cell, rows.weights)
    weight = rows.weights / total[cell]

    def mean(q: Array) -> Array:
        return np.asarray(np.bincount(cell, weight * q), float)

    quantities = (rows.contraction, rows.pressure, rows.force)
    means = [mean(q) for q in quantities]
    apart = [(q - m[cell]) / max(np.ptp(q), 1e-300) for q, m in zip(quantities, means, strict=True)]
    moments = np.stack([np.stack([mean(a * b) for b in apart], axis=-1) for a in apart], axis=-1)  # (cells, 3, 3)
    cells = replace(
        rows,
        contraction=means[0],
        pressure=means[1],
        force=means[2],
        weights=np.minimum(total / np.median(total), 1.0),
        scatter=np.ptp(rows.force) * _scatter(moments),
        direction=None,  # both branches are in a cell
        file=None if rows.file is None else file[first],
    )
    return cells.noted(
        f"{samples.n} rows became {total.size} samples, means over cells of contraction and pressure (loading and "
        "unloading averaged), each counted as one reading"
    )


def _scatter(moments: Array) -> Array:
    """Return the standard deviation (cells,) of the last quantity about a plane over the others, by second moments."""
    C, c = moments[:, :2, :2], moments[:, :2, 2]  # moments of the first two, and with the last
    explained = np.einsum("ki,kij,kj->k", c, np.linalg.pinv(C, rcond=1e-9, hermitian=True), c)
    return np.asarray(np.sqrt(np.maximum(moments[:, 2, 2] - explained, 0.0)))
