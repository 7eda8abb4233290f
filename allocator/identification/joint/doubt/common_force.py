"""Force common to both muscles: whether the data determine it, and its bounds if they do not.

Angles at rest determine only a1 F1 - a2 F2: forces ΔF_i = C ā/a_i, with the mean arm ā and any constant C [N], move no
angle on any mechanism. Only a cable that goes slack reveals them. Friction in proportion to the forces, and the form of
a law without a term like C, seem to reveal them too, but neither is a measurement: with the law of another type of
muscle, on a lever, the form gave three times the true forces. The data are therefore tested

by rank: whether there are readings of a sag test, without which C is absent from the equations, and
by profile likelihood: whether the cost rises by 4 σ² on both sides if the pull share φ (see `problem`) is fixed away
    from the optimum and all else is fitted again, with a constant friction torque and a constant play in addition to μ;
    σ² = cost/(cells - unknowns), samples at the same pressures and torque being one cell.

If it is not determined, its bounds are physical: at most a tenth of the measured forces are negative, and φ ≤ 1.05,
since a contracted muscle without pressure does not pull. φ is then assumed: that of a prior; or else, cautiously, the
least φ at which (all but a fiftieth of) the forces have the share η of their mean. It is moved only until the cost has
risen by a tenth, within the law's own error.

If friction in proportion to the forces determines φ, the assumed φ lies between that value and the cautious one. It
moves from the former towards the latter until the cost, without constant friction and play, has risen by a tenth times
exp((Δ - 2 log cells)/2). These are the odds by the information criterion BIC that constant parts are present, and Δ
[σ²] is their gain. A threshold of Δ instead would let chance near it change the fit by a jump.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.identification.joint.problem import JointProblem, PullShare
from allocator.identification.joint.search import best_start, minimise
from allocator.identification.least_squares import rms
from allocator.joint.limits import COMMON_FORCE, PRIOR_FORCE
from allocator.muscles import Muscle, force_gradient

_FIRM = 2000.0  # [σ] weight of a pull share that is set
_ROUNDS = 2
_HELD = 200.0  # times the scatter of the angles: weight in the profile, whose points need not lie on the grid
_WEAK = 0.02  # [rad] … and of one that only guides the search
_USUAL = 0.5  # pull share that it aims at [-]
_MOST = 1.05  # pull share [-]
_STEP = 0.1
_STEPS = 30
_CERTAIN = 100.0  # greater logarithms of odds mean the same
_PLAUSIBLE = 0.1  # with a smaller pull share a muscle would be nearly slack everywhere [-]
_RISE = 4.0  # [σ²]
_LAW = 0.1  # of the cost: accepted rise due to the form of a law
_NEGATIVE = 0.1  # of the forces, at the lower bound
_SLACK = 0.02  # of the forces, at the cautious assumption
_KNOWN = 1e-9  # relative change of φ: below it φ does not depend on the unknowns
_ALIKE = 0.1  # standard deviation of φ between muscles of one type, if the prior has no covariance [-]
_FREE = ("coulomb", "play")  # friction in addition to μ
_ASSUMED = 0.15  # standard deviation of an assumed φ [-]
_NORMAL = 1.96
_LEAST_ERROR = 1e-6  # [rad] noise assumed of exact data


@dataclass(frozen=True)
class CommonForce:
    """Common force, either determined by the data or assumed within bounds."""

    share: float  # φ of the fit [-]
    low: float  # C [N], on the force scale of the problem: lower …
    high: float  # … and upper end: 95 % if it is determined or that of a prior, else physical bounds
    seen: bool
    source: str  # its source, in words
    ends: tuple[Array, Array] | None  # unknowns (m,) of the best fits at two φ, four standard deviations apart
    prior: "Prior | None" = None  # its source, if any
    share_std: float = _ASSUMED  # standard deviation of φ [-]

    @property
    def unseen(self) -> tuple[str, ...]:
        """Return the words for `AntagonistJoint.unseen`."""
        if self.seen:
            return ()
        return (PRIOR_FORCE,) if self.prior else (COMMON_FORCE,)

    @property
    def said(self) -> tuple[str, ...]:
        """Return a sentence about the undetermined common force and its assumed value, or "" if it is determined."""
        return () if self.seen else (f"{COMMON_FORCE}; it is taken from {self.source}",)


class Prior(NamedTuple):
    """Pull share φ of another muscle, as a prior."""

    share: float  # [-]
    std: float  # [-]
    name: str


class Point(NamedTuple):
    """Least cost at a value of φ."""

    share: float
    x: Array
    cost: float


def guided(problem: JointProblem) -> JointProblem:
    """Return the problem with a weak equation that guides φ to a usual value if nothing else determines it."""
    return replace(problem, pull=PullShare(_USUAL, _WEAK))


def with_free_friction(problem: JointProblem) -> JointProblem:
    """Return the problem with a constant friction torque and a constant play in addition to μ, if μ is fitted."""
    if "friction" not in problem.extra or set(_FREE) & set(problem.extra):
        return problem
    unbounded = np.full(len(_FREE), np.inf)
    lower, upper = np.append(problem.lower, -unbounded), np.append(problem.upper, unbounded)
    return replace(problem, extra=(*problem.extra, *_FREE), lower=lower, upper=upper)


def prior_of(problem: JointProblem, muscle: Muscle | Prior | None) -> Prior | None:
    """Return the prior of φ that `muscle` implies at the samples; its strength does not matter.

    Raises InvalidInput if its law gives no force there.
    """
    if muscle is None or isinstance(muscle, Prior):
        return muscle
    if not isinstance(muscle, Muscle):
        raise InvalidInput(f"prior = {checks.brief(muscle)} has to be a muscle, of the catalogue or of a fit to forces")
    P, eps = problem.samples.muscles()
    with np.errstate(all="ignore"):
        given = float(np.sum(P * muscle.gain(P, eps)))
        share = float(np.sum(muscle.law(P, eps))) / given
    name = type(muscle).__name__
    if not 0 < share < 2:
        raise InvalidInput(
            f"prior: {name} pulls with {share:.2g} of what the pressure gives it, in the mean of these equilibria, "
            "which is no muscle of the joint's kind"
        )
    std = _ALIKE
    if muscle.covariance is not None:
        gradient = force_gradient(muscle, P, eps).sum(axis=0) / given
        std = max(float(np.sqrt(gradient @ np.asarray(muscle.covariance) @ gradient)), 1e-3)
    return Prior(share, std, name)


def settle(problem: JointProblem, x: Array, prior: Prior | None) -> tuple[JointProblem, Array, CommonForce]:
    """Return the problem with the equation for φ if it is not determined, the start, and the common force."""
    name, problem = type(problem.prototype).__name__, replace(problem, pull=None)
    if not problem.free:
        share = problem.pull_share(problem.unknowns(x)).real
        return problem, x, _assumed(problem, x, f"the {name} that was given", Prior(share, _ALIKE, name))
    if not _moves(problem, x):
        return problem, x, _assumed(problem, x, f"the form of {name}, which has no other", None)
    problem = _weighted(problem, x)
    profile = Profile.of(problem, x)
    best, variance = profile.best, profile.variance
    (low, low_rises), (high, high_rises) = (profile.end(side, _RISE * variance) for side in (-1, 1))
    if problem.sag is not None and low_rises and high_rises:
        less, more = ((share - best.share) * _per_share(profile.problem, best.x) for share in (low, high))
        std, ends = (high - low) / (2 * _NORMAL), profile.ends(low, high)
        found = CommonForce(best.share, less, more, True, "the sag test", ends, share_std=std)
        return _held(problem, profile, found.share), best.x[: x.size], found
    return _set(problem, profile, prior)


def _held(problem: JointProblem, profile: "Profile", share: float) -> JointProblem:
    """Return the problem in which φ is so firm that wrong friction cannot move it."""
    return replace(problem, pull=PullShare(share, _FIRM * np.sqrt(profile.variance)))


def _set(problem: JointProblem, profile: "Profile", prior: Prior | None) -> tuple[JointProblem, Array, CommonForce]:
    """Return the problem, the start, and φ by a prior or an assumption."""
    limit = _RISE * profile.variance + _LAW * profile.best.cost
    low, high = (profile.end(side, limit)[0] for side in (-1, 1))
    wanted = profile.cautious if prior is None else prior.share
    share = float(np.clip(np.clip(wanted, low, high), _PLAUSIBLE, _MOST))
    source = "the assumption that no cable was far from slack" if prior is None else f"the prior {prior.name}"
    half = np.inf if prior is None else 2 * prior.std
    starts, shown = [], profile.shown_by_friction(share) if prior is None else None
    if shown is not None:
        starts = [shown.x]
        if shown.share != share:
            share, source = shown.share, "the assumption that friction is proportional to it"
    start = profile.at(share)
    found = replace(_assumed(profile.problem, start.x, source, prior), ends=profile.ends(wanted - half, wanted + half))
    held = _held(problem, profile, found.share)
    return held, best_start(held, (*starts, start.x[: profile.unknowns])), found


def _assumed(problem: JointProblem, x: Array, source: str, prior: Prior | None) -> CommonForce:
    """Return the assumed common force; the interval of a prior is four deviations wide."""
    share = problem.pull_share(problem.unknowns(x)).real
    if prior is None:  # the physical bounds, which enclose the fit
        forces = problem.measured_forces(problem.unknowns(x)) / problem.common_weight
        low = min(-float(np.quantile(forces, _NEGATIVE)), 0.0)
        high = max((_MOST - share) * _per_share(problem, x), 0.0)
    else:
        off, half = ((part * _per_share(problem, x)) for part in (prior.share - share, 2 * prior.std))
        low, high = min(off, 0.0) - half, max(off, 0.0) + half
    return CommonForce(share, low, high, False, source, None, prior, _ASSUMED if prior is None else prior.std)


def _per_share(problem: JointProblem, x: Array) -> float:
    """Return ∂C/∂φ [N]."""
    u = problem.unknowns(x)
    given = problem.measured_forces(u).sum() / problem.pull_share(u).real
    return float(given / problem.common_weight.sum())


def _weighted(problem: JointProblem, x: Array) -> JointProblem:
    """Return the problem with the weight of the sag test by the scatter of the angles."""
    if problem.sag is None:
        return problem
    wide = with_free_friction(replace(problem, pull=None, sag=None))
    share = problem.pull_share(problem.unknowns(x)).real
    x = _fixed(wide, share, np.append(x, np.zeros(len(wide.names) - x.size))).x
    scatter = rms(wide.angle_error(x))
    return replace(problem, sag_weight=max(scatter, _LEAST_ERROR) / problem.sag.noise)


def _moves(problem: JointProblem, x: Array) -> bool:
    """Return whether the unknowns can change φ: in some laws it is constant."""
    share = problem.pull_share(problem.unknowns(x)).real
    gradient = problem.gradient(lambda u: np.array([problem.pull_share(u)]), x)[0]
    return bool(np.linalg.norm(gradient * np.maximum(np.abs(x), 1e-3)) > _KNOWN * abs(share))


@dataclass(frozen=True)
class Profile:
    """Least costs at values of φ."""

    problem: JointProblem  # with a free friction, and no equation for tautness
    unknowns: int  # m without that torque
    points: tuple[Point, ...]  # in the order of φ
    cells: int
    variance: float  # σ² [rad²]
    least: float  # η of the problem [-]

    @classmethod
    def of(cls, problem: JointProblem, x: Array) -> "Profile":
        """Return the profile of this problem, from `x` in both directions to its ends by the cost or by physics."""
        wide = with_free_friction(replace(problem, pull=None, taut_min=-np.inf))
        first = _point(wide, np.append(x, np.zeros(len(wide.names) - x.size)))
        first = _fixed(wide, float(np.clip(first.share, _PLAUSIBLE, _MOST)), first.x)  # the law may prefer nonsense
        cells = int(problem.samples.setpoints.max()) + 1 + (problem.sag.n if problem.sag is not None else 0)
        freedom = max(cells - len(wide.names), 1)
        points = [first]
        for side in (-1, 1):
            points = _walked(wide, points, side, freedom)
        best = min(points, key=lambda point: point.cost)
        if best not in (points[0], points[-1]):  # a least cost inside
            better = _point(wide, minimise(wide, best.x)[0])
            if points[0].share < better.share < points[-1].share and better.cost < best.cost:
                points.append(better)
        points.sort(key=lambda point: point.share)
        variance = max(min(p.cost for p in points) / freedom, _LEAST_ERROR**2)
        return cls(wide, x.size, tuple(points), cells, variance, problem.taut_min)

    @property
    def best(self) -> Point:
        """Return the point of the least cost."""
        return min(self.points, key=lambda point: point.cost)

    def end(self, side: int, limit: float) -> tuple[float, bool]:
        """Return φ below (-1) or above (+1) the best at which the cost has risen by `limit`, and whether it does."""
        best = inner = self.best
        for point in sorted(self.points, key=lambda p: side * p.share):
            if side * (point.share - best.share) <= 0:
                continue
            rise = point.cost - best.cost
            if rise > limit:  # the root of a parabolic cost is linear
                before = np.sqrt(max(inner.cost - best.cost, 0.0))
                part = (np.sqrt(limit) - before) / (np.sqrt(rise) - before)
                return float(inner.share + part * (point.share - inner.share)), True
            inner = point
        return inner.share, False

    @property
    def cautious(self) -> float:
        """Return φ at the cautious assumption of the module."""
        levels = [self.problem.shares(self.problem.unknowns(p.x)) for p in self.points]
        left = np.array([np.quantile(level, _SLACK) for level in levels])
        slack = left < self.least
        if slack.all() or not slack.any():
            return self.points[-1 if slack.all() else 0].share
        i = int(np.flatnonzero(slack)[-1])  # the last that is too slack
        i = min(i, len(self.points) - 2)
        shares = [p.share for p in self.points[i : i + 2]]
        return float(np.interp(self.least, left[i : i + 2], shares))

    def shown_by_friction(self, cautious: float) -> Point | None:
        """Return the best fit with friction in proportion to the forces, its φ moved towards `cautious` (see the top).

        None if there is no friction, or if the cost does not rise by 4 σ² on both sides.
        """
        n = self.unknowns
        simple = replace(
            self.problem,
            extra=tuple(name for name in self.problem.extra if name not in _FREE),
            lower=self.problem.lower[:n],
            upper=self.problem.upper[:n],
        )
        if simple.extra == self.problem.extra:
            return None
        best = _point(simple, minimise(replace(simple, pull=PullShare(self.best.share, _WEAK)), self.best.x[:n])[0])
        if not _PLAUSIBLE < best.share < _MOST:
            return None
        beside = [_fixed(simple, best.share + side * _STEP, best.x) for side in (-1, 1)]
        rises = [(p.cost - best.cost) * (_STEP / (p.share - best.share)) ** 2 for p in beside]
        steep = min(rises) - _RISE * self.variance
        if steep <= 0:
            return None
        odds = np.exp(min((best.cost - self.best.cost) / self.variance / 2, _CERTAIN)) / self.cells
        far = _STEP * np.sqrt(_LAW * best.cost * odds / steep)  # the cost rises with the square of the distance
        return best._replace(share=best.share + float(np.clip(cautious - best.share, -far, far)))

    def ends(self, low: float, high: float) -> tuple[Array, Array]:
        """Return the unknowns (m,) of the best fits at the ends of φ, within the cost's rise by chance."""
        least, most = (self.end(side, _RISE * self.variance)[0] for side in (-1, 1))
        one, other = (self.at(min(max(share, least), most)).x[: self.unknowns] for share in (low, high))
        return one, other

    def at(self, share: float) -> Point:
        """Return the least cost at this φ."""
        near = min(self.points, key=lambda point: abs(point.share - share))
        return _fixed(self.problem, share, near.x)


def _walked(wide: JointProblem, points: list[Point], side: int, freedom: int) -> list[Point]:
    """Return `points` and those beyond them in the direction `side`, one step of φ after the other.

    They end at the physical bounds, or, with a sag test, at a sufficient rise of the cost.
    """
    points = list(points)
    edge = max(points, key=lambda p: side * p.share)
    share = edge.share
    for _ in range(_STEPS):
        forces = wide.measured_forces(wide.unknowns(edge.x))
        if share >= _MOST if side > 0 else share < _STEP or (forces < 0).mean() > _NEGATIVE:
            break
        share = min(share + _STEP, _MOST) if side > 0 else share - _STEP
        edge = _fixed(wide, share, edge.x)
        points.append(edge)
        least = min(p.cost for p in points)
        if edge.cost - least > (2 * _RISE / freedom + 2 * _LAW * (wide.sag is None)) * least:
            break
    return points


def _fixed(wide: JointProblem, share: float, x: Array) -> Point:
    """Return the least cost at the pull share `share`, searched from `x`."""
    scatter = rms(wide.angle_error(x))
    weight = _HELD * max(scatter, _LEAST_ERROR)
    return _point(wide, minimise(replace(wide, pull=PullShare(share, weight)), x, _ROUNDS)[0])


def _point(wide: JointProblem, x: Array) -> Point:
    r = wide.residual(x)
    return Point(wide.pull_share(wide.unknowns(x)).real, x, float(r @ r))
