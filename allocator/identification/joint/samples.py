"""Measured equilibria of a joint (angle, pressures, torque of a weight, direction of motion), and sag tests."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.end_stops import stops_of_rests
from allocator.identification.outliers import outlying, some
from allocator.joint.geometry import Geometry
from allocator.units import BAR, DEG

Geometries = Geometry | Mapping[str, Geometry] | Mapping[int, Geometry] | Mapping[float, Geometry]
Routes = tuple[tuple[Array, Array, Array], tuple[Array, Array, Array], Array]

_COLUMNS = ("theta", "P1", "P2", "torque", "direction", "group")
_CELL = 0.05 * BAR  # [Pa]
_WIDER = 2**0.5
_WIDEST = 2 * BAR  # if cells must be wider, there are many torques or groups
THRESHOLD = 0.3 * BAR  # P_t of home-made muscles [Pa]


class Group(NamedTuple):
    """Samples of one mechanism, e.g. of one muscle length."""

    label: str
    geometry: Geometry


@dataclass(frozen=True)
class JointSamples:
    """Samples of n equilibria; arrays [n].

    The joint carries `torque`, which the muscles have to produce.
    """

    theta: Array  # encoder reading [rad]
    P1: Array  # agonist, gauge [Pa]
    P2: Array  # antagonist, gauge [Pa]
    torque: Array  # of the weight, positive if it pulls θ down [N·m]
    direction: Array  # +1 if θ was rising, -1 falling, 0 unknown [-]
    group: NDArray[np.intp]  # index into `groups`
    groups: tuple[Group, ...]
    dropped: Mapping[str, int] = field(default_factory=dict)  # numbers of samples left out, by reason
    cell: float = _CELL  # `pairs` treats pressures in one cell of this width as equal [Pa]
    measured: int = 0  # number of samples averaged over such cells, if any
    zero: float = 0.0  # rough encoder zero: contractions and arms are taken at the angles less it [rad]

    @classmethod
    def checked(
        cls,
        theta: ArrayLike,
        P1: ArrayLike,
        P2: ArrayLike,
        *,
        geometry: Geometries,
        torque: ArrayLike | None = None,
        direction: ArrayLike | None = None,
        group: ArrayLike | None = None,
        zero: float = 0.0,
    ) -> Self:
        """Return checked samples from array-like data.

        Raises `InvalidInput` unless they can be measured equilibria in SI units.
        """
        named = {
            "theta": checks.angle("theta", theta),
            "P1": checks.pressure("P1", P1),
            "P2": checks.pressure("P2", P2),
            "torque": checks.real("torque", 0.0 if torque is None else torque, "N·m"),
            "direction": checks.real("direction", 0.0 if direction is None else direction, "+1, -1 or 0"),
        }
        if not np.isin(named["direction"], (-1, 0, 1)).all():
            raise InvalidInput("direction has to be +1 where θ was rising, -1 where falling, 0 where not known")
        theta, P1, P2, torque, direction = (np.array(a, float).ravel() for a in checks.broadcast(**named))
        index, groups = _grouped(geometry, group, theta.size)
        held = float(checks.angle("zero", checks.number("zero", zero, "rad")))
        samples = cls(theta, P1, P2, torque, direction, index, groups, zero=held)
        samples.check_reach()
        return samples

    @property
    def n(self) -> int:
        """Return the number of samples."""
        return self.theta.size

    @property
    def loaded(self) -> bool:
        """Return whether any torque is not zero, which forces can be determined from."""
        return bool((self.torque != 0).any())

    def where(self, keep: Mask | NDArray[np.intp]) -> Self:
        """Return the samples marked in `keep`, or those of these indices."""
        return replace(self, **{name: getattr(self, name)[keep] for name in _COLUMNS})

    def without(self, drop: Mask, reason: str) -> Self:
        """Return the samples not in the mask `drop`, and record the number dropped under `reason`."""
        if not drop.any():
            return self
        return replace(self.where(~drop), dropped={**self.dropped, reason: int(drop.sum())})

    def without_stops(self) -> Self:
        """Return the samples without those that rest on an end stop, which carries torque; they are counted."""
        kept, free = self, np.ones(self.n, bool)
        for stop in stops_of_rests(self.theta, self.P1, self.P2).values():
            reason = f"an angle at a stop, the {stop.end} one of {stop.angle / DEG:.3g}°, whatever the pressures"
            kept, free = kept.without(stop.there[free], reason), free & ~stop.there
        return kept

    def without_outliers(self) -> Self:
        """Return the samples without outliers among angles at similar pressures, which are listed."""
        kinds = np.stack([self.torque, self.direction, self.group.astype(float)], axis=1)
        apart = outlying(np.stack([self.P1, self.P2], axis=1), self.theta, kinds)
        shown = [
            f"{theta / DEG:.3g}° at {P1 / BAR:.3g} and {P2 / BAR:.3g} bar"
            for theta, P1, P2 in zip(self.theta[apart], self.P1[apart], self.P2[apart], strict=True)
        ]
        return self.without(apart, f"angle apart from those at like pressures: {some(shown)}")

    def routes(self, theta: Array) -> Routes:
        """Return (ε, a, a') of agonist and antagonist at the true angles `theta` (n,), and the rest lengths (n,)."""
        columns = np.empty((7, self.n))
        for i, (_, geometry) in enumerate(self.groups):
            here = self.group == i if len(self.groups) > 1 else slice(None)
            at = theta[here]
            columns[:3, here], columns[3:6, here] = geometry.agonist(at), geometry.antagonist(at)
            columns[6, here] = geometry.rest_length
        one, two = columns[:3], columns[3:6]
        return (one[0], one[1], one[2]), (two[0], two[1], two[2]), columns[6]

    def muscles(self, zero: float | None = None) -> tuple[Array, Array]:
        """Return pressures [Pa] and contractions [-] (2n,), the agonist's first, at the angles less `zero`.

        By default, `zero` is the rough one of the samples.
        """
        (eps1, *_), (eps2, *_), _ = self.routes(self.true_angles(self.zero if zero is None else zero))
        return np.concatenate([self.P1, self.P2]), np.concatenate([eps1, eps2])

    def true_angles(self, zero: float) -> Array:
        """Return the measured angles less `zero` [rad], within each sample's mechanism (n,)."""
        return np.clip(self.theta - zero, *self.reach())

    def reach(self) -> tuple[Array, Array]:
        """Return the ends (n,), (n,) [rad] of each sample's mechanism."""
        ends = np.array([geometry.reach for _, geometry in self.groups])
        return ends[self.group, 0], ends[self.group, 1]

    @property
    def setpoints(self) -> NDArray[np.intp]:
        """Return the number (n,) of each sample's setpoint: the same pressures (in one `cell`), torque and group."""
        P1, P2 = np.round(self.P1 / self.cell), np.round(self.P2 / self.cell)
        return np.unique(_combined(self.group, P1, P2, np.round(self.torque, 6)), return_inverse=True)[1]

    def pairs(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Return the index arrays (rising, falling) of samples at the same setpoint."""
        place = self.setpoints
        order = np.argsort(place, kind="stable")
        members = np.split(order, np.flatnonzero(np.diff(place[order])) + 1)
        both = [(m[self.direction[m] > 0], m[self.direction[m] < 0]) for m in members]
        return [(up, down) for up, down in both if up.size and down.size]

    def averaged(self) -> Self:
        """Return the mean of rising and falling samples at the same pressures; those without a partner are dropped."""
        pairs = self.pairs()
        if not pairs:
            raise InvalidInput("average needs the same pressures visited with rising and with falling angle; none were")
        used = sum(up.size + down.size for up, down in pairs)
        dropped = dict(self.dropped)
        if used < self.n:
            dropped["visited in one direction only, so that there is no mean"] = self.n - used

        def mean(a: Array) -> Array:
            return np.array([(a[up].mean() + a[down].mean()) / 2 for up, down in pairs])

        theta, P1, P2, torque = map(mean, (self.theta, self.P1, self.P2, self.torque))
        way, group = np.zeros(len(pairs)), np.array([self.group[up[0]] for up, _ in pairs])
        return replace(self, theta=theta, P1=P1, P2=P2, torque=torque, direction=way, group=group, dropped=dropped)

    def binned(self, most: int) -> Self:
        """Return at most about `most` samples: if there are more, the means of those in the same cell.

        A cell holds one group, one direction and one torque, to 1 % of the greatest; it is 0.05 bar wide in either
        pressure, or wider by as little as needed. Every mean counts once, whatever its number of samples: consecutive
        samples at rest are not independent.
        """
        if self.n <= most:
            return self
        load = np.abs(self.torque).max() / 100 or 1.0
        cell = self.cell
        while True:
            rounded = (self.torque / load, self.P1 / cell, self.P2 / cell)
            key = _combined(self.group, self.direction, *(np.round(a) for a in rounded))
            _, first, place, count = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
            if count.size <= most or cell > _WIDEST:
                break
            cell *= _WIDER
        theta, P1, P2, torque = (np.bincount(place, a) / count for a in (self.theta, self.P1, self.P2, self.torque))
        mean = replace(self.where(first), theta=theta, P1=P1, P2=P2, torque=torque)
        return replace(mean, cell=cell, measured=self.n)

    def check_reach(self) -> None:
        """Refuse angles beyond the mechanism's range, or that would tear or crush a muscle."""
        low, high = self.reach()
        turned = self.theta - self.zero
        beyond = (turned < low) | (turned > high)
        inside = np.clip(turned, low, high)
        (eps1, *_), (eps2, *_), _ = self.routes(inside)
        for muscle, eps in (("agonist", eps1), ("antagonist", eps2)):
            wrong = beyond | (eps < _CONTRACTIONS[0]) | (eps > _CONTRACTIONS[1])
            if wrong.any():
                i = int(np.argmax(wrong))
                raise InvalidInput(
                    f"theta[{i}] = {self.theta[i]:.4g} rad cannot be reached with this geometry: the {muscle}'s "
                    f"contraction would be {eps[i]:.2g}; is the rest length or the lever wrong, or the angle in "
                    "another unit, or from another zero?"
                )


@dataclass(frozen=True)
class SlackReadings:
    """Readings of a sag test: pressures at which a cable just goes slack, F_i = 0, at an angle; arrays [k].

    A row of the table in which both cables go slack gives two readings.
    """

    samples: JointSamples  # k: angles and pressures; torque and direction are meaningless
    agonist: Mask  # (k,) True: muscle 1 goes slack, False: muscle 2
    noise: float  # standard deviation of these pressures [Pa]

    @classmethod
    def of(cls, samples: JointSamples, slack: NDArray[np.intp], noise: float) -> "SlackReadings | None":
        """Return the readings among the samples, with `slack` (n,) 1, 2 or 3 (both); None if there are none."""
        one, two = np.flatnonzero(slack & 1), np.flatnonzero(slack & 2)
        if not one.size + two.size:
            return None
        return cls(samples.where(np.concatenate([one, two])), np.arange(one.size + two.size) < one.size, noise)

    @property
    def n(self) -> int:
        """Return the number of readings."""
        return self.agonist.size

    def muscles(self, zero: complex) -> tuple[Array, Array]:
        """Return pressure (k,) [Pa] and contraction (k,) of the muscle that goes slack; `zero` is the encoder's [rad].

        Complex if `zero` is.
        """
        s = self.samples
        low, high = s.reach()
        (eps1, arm1, _), (eps2, arm2, _), l0 = s.routes(np.clip(s.theta - np.real(zero), low, high))
        turned = -1j * np.imag(zero)  # ∂ε1/∂θ = a1/l0, ∂ε2/∂θ = -a2/l0
        eps = np.where(self.agonist, eps1 + turned * arm1 / l0, eps2 - turned * arm2 / l0)
        return np.where(self.agonist, s.P1, s.P2), eps if np.imag(zero) else np.real(eps)


_CONTRACTIONS = -0.25, 0.6  # [-] limits of all muscles of this family


def _combined(*columns: Array | NDArray[np.intp]) -> NDArray[np.int64]:
    """Return one number (n,) for each combination of the values in the columns (n,)."""
    key = np.zeros(columns[0].size, np.int64)
    for column in columns:
        found, place = np.unique(column, return_inverse=True)
        key = key * found.size + place
    return key


def _grouped(geometry: Geometries, group: ArrayLike | None, n: int) -> tuple[NDArray[np.intp], tuple[Group, ...]]:
    labels = np.full(n, "all") if group is None else np.asarray(group).ravel()
    if labels.size != n:
        raise InvalidInput(f"group has {labels.size} labels for {n} samples")
    found, index = np.unique(labels, return_inverse=True)
    if isinstance(geometry, Geometry):
        return index.ravel(), tuple(Group(str(label), geometry) for label in found)
    if group is None:
        raise InvalidInput("several geometries need group=, the label of each sample's geometry")
    missing = [label for label in found.tolist() if label not in geometry]
    if missing:
        raise InvalidInput(f"geometry has no {missing[0]!r}; it has {', '.join(map(repr, geometry))}")
    return index.ravel(), tuple(Group(str(label), geometry[label]) for label in found.tolist())


def weighed(sag: SlackReadings, error: Array, has_threshold: bool) -> Array:
    """Return errors (k,) [Pa] of the pressures, transformed to independent ones of the standard deviation `sag.noise`.

    The bladder of a home-made muscle presses on the braid only above a threshold pressure P_t of 0.1 to 0.3 bar. A law
    without a threshold, fitted to equilibria far above it, errs by about b = P_t e^{-P/P_t} if a cable goes slack at P,
    in the same direction in all rows: the covariance is σ² I + b bᵀ. For a law with a threshold it is σ² I. Complex if
    `error` is.
    """
    if has_threshold:
        return error
    s = sag.samples
    b = THRESHOLD * np.exp(-np.where(sag.agonist, s.P1, s.P2) / THRESHOLD) / sag.noise
    square = float(b @ b)
    if square == 0:
        return error
    shrunk = 1 - 1 / np.sqrt(1 + square)  # (I + b bᵀ)^(-1/2) = I - shrunk b bᵀ/(bᵀ b)
    return np.asarray(error - shrunk * b * (b @ error) / square)
