"""Figures and warnings about the solution of a joint's fit."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from math import hypot
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.joint.problem import FITTED_GRAVITY, JointProblem, Unknowns
from allocator.identification.joint.relative import stiffness_with_gradient
from allocator.identification.joint.search import minimise
from allocator.identification.least_squares import at_bound, determine, rms
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles import monotonicity_failure, scaled, strength_powers
from allocator.muscles.monotonicity import FAILS
from allocator.rough_tables import ROUGH, doubt, sentence
from allocator.units import BAR, DEG

_DETERMINANT_GRID = 7
_MOST_MISSED = 0.05  # of the samples for which the model may have no equilibrium
_POOR_SCALE = 0.25
_LARGE_ZERO = 15.0  # [deg] encoders are zeroed more accurately
_SOME_ZERO = 1.0  # [deg] more is rare in an encoder that was zeroed
_LOST_GRAVITY = 0.05  # of its amplitude: standard deviation beyond which it is not told from the muscles
_MOST_AREA = 0.05  # [m²] mean ∂F/∂P, five times that of the strongest commercial muscles
_SAG_MISSED = 5.0  # times their standard deviation, root mean square
NO_FRICTION = 1e-3  # a smaller |μ| is negligible


class GroupError(NamedTuple):
    """Angle errors of a group."""

    label: str
    samples: int
    rms: float  # [rad]
    left_out: float  # RMS [rad] when the group was left out of the fit; NaN if impossible


class Findings(NamedTuple):
    """Properties of a fit that may deserve a warning."""

    converged: bool
    failure: str  # failure of [M], if any
    determinant_positive: bool
    slack: int  # forces below `taut_min`
    hysteresis_share: float
    std: Mapping[str, float]  # of the unknowns by name
    scale_std: float | None
    rough: float  # greatest doubt of the stiffness by a table


def checked(problem: JointProblem, x: Array) -> Unknowns:
    """Return the unknowns, with the muscle checked. Raises InvalidInput if many samples have no equilibrium."""
    u = problem.unknowns(x)
    _, reached = problem.equilibrium(u)
    name = type(problem.prototype).__name__
    if (~reached).mean() > _MOST_MISSED:
        raise InvalidInput(
            f"no {name} was found whose joint holds itself at these pressures: {(~reached).sum()} of {reached.size} "
            "equilibria are missed altogether; is the geometry right?"
        )
    try:
        return u._replace(muscle=replace(u.muscle))
    except InvalidInput as error:
        raise InvalidInput(f"the best {name} makes no sense as a muscle: {error}") from None


def unseen(problem: JointProblem, x: Array) -> tuple[str, ...]:
    """Return the directions that change neither angles nor a given pull share; the force scale by its name."""
    n = problem.samples.n
    r, J = problem.residual(x), problem.jacobian(x)
    told = np.concatenate([np.ones(n, bool), np.zeros(2 * n, bool), np.ones(r.size - 3 * n, bool)])
    if problem.conventional:
        told[3 * n] = False
    r, J = r[told], J[told]
    directions = determine(J, float(r @ r), problem.names, x).collinear
    if not problem.conventional:
        return directions
    scale = "all forces times one factor (no torque was hung): absolute stiffness is not known"
    return (scale, *directions) if len(directions) != 1 else (scale,)


def parameter_jacobian(problem: JointProblem, u: Unknowns) -> Array:
    """Return ∂q/∂x (2k, m): parameters q of agonist and antagonist; the antagonist's are scaled by the ratio."""
    names = list(u.muscle.parameters)
    powers = strength_powers(u.muscle) if "log_ratio" in problem.extra else np.zeros(len(names))
    values = np.array(list(u.muscle.parameters.values()))
    k = len(names)
    J = np.zeros((2 * k, len(problem.names)))
    for column, name in enumerate(problem.names):
        if name in names:
            i = names.index(name)
            J[i, column], J[k + i, column] = 1.0, u.ratio ** powers[i]
        elif name == "log_ratio":
            J[k:, column] = powers * values * u.ratio**powers
    return J


def joints(
    problem: JointProblem, u: Unknowns, covariance: Array, unseen: tuple[str, ...]
) -> dict[str, AntagonistJoint]:
    """Return the fitted joints by group, with the covariance of the parameters of both muscles."""
    J = parameter_jacobian(problem, u)
    C, samples = tuple(map(tuple, (J @ covariance @ J.T).tolist())), problem.samples
    antagonist = scaled(u.muscle, u.ratio)
    supply = (0.0, float(max(samples.P1.max(), samples.P2.max())))
    joints = {}
    for i, (label, geometry) in enumerate(samples.groups):
        angles = (samples.theta - u.zero)[samples.group == i]
        least = min(
            float(geometry.agonist(angles).contraction.min()), float(geometry.antagonist(angles).contraction.min())
        )
        joints[label] = AntagonistJoint(
            geometry,
            u.muscle,
            antagonist,
            supply,
            min(0.025, least - 0.005),
            (float(angles.min()), float(angles.max())),
            friction=max(u.friction, 0.0),
            covariance=C if u.muscle.parameters else None,
            unseen=unseen,
        )
    return joints


def rough_joints(problem: JointProblem, u: Unknowns) -> list[tuple[Mask, AntagonistJoint]]:
    """Return the samples (n,) and the joint of each group, with limits wider than those of its samples."""
    s, antagonist = problem.samples, scaled(u.muscle, float(u.ratio))
    return [
        (s.group == i, AntagonistJoint(group.geometry, u.muscle, antagonist, min_contraction=-0.3))
        for i, group in enumerate(s.groups)
    ]


def _scale_std(problem: JointProblem, u: Unknowns, covariance: Array) -> float:
    """Return the relative standard deviation of K at the samples, in the mean: dominated by that of the scale."""
    J, s = parameter_jacobian(problem, u), problem.samples
    here, joint = rough_joints(problem, u)[int(np.bincount(s.group).argmax())]
    K = stiffness_with_gradient(joint, s.theta[here] - u.zero, s.P1[here], s.P2[here])
    return float(np.median(K.relative_std(J @ covariance @ J.T)))


def groups(problem: JointProblem, x: Array, error: Array, leave_one_out: bool) -> tuple[GroupError, ...]:
    """Return the errors of each group; with `leave_one_out` also those of predictions without it."""
    found = []
    for i, (label, _) in enumerate(problem.samples.groups):
        here, left_out = problem.samples.group == i, float("nan")
        if leave_one_out and not here.all() and (~here).sum() > x.size:
            left_out = rms(problem.on(here).angle_error(minimise(problem.on(~here), x)[0]))
        found.append(GroupError(label, int(here.sum()), rms(error[here]), left_out))
    return tuple(found)


def _hysteresis_share(problem: JointProblem, u: Unknowns) -> float:
    """Return Σ h²/(Σ h² + Σ m²): h half the difference, m the mean of the errors of a rising and a falling sample."""
    pairs = problem.samples.pairs()
    if not pairs:
        return float("nan")
    theta, _ = problem.still().equilibrium(u)
    error = problem.samples.theta - u.zero - theta
    up, down = (np.array([error[pair[k]].mean() for pair in pairs]) for k in (0, 1))
    h, m = np.sum(((up - down) / 2) ** 2), np.sum(((up + down) / 2) ** 2)
    return float(h / (h + m))


def _determinant_positive(joint: AntagonistJoint) -> bool:
    """Return whether det ∂(T, K)/∂(P1, -P2) > 0 wherever both muscles are taut, on a grid."""
    low, high = joint.pressure_limits
    angles = np.linspace(*joint.angle_range, _DETERMINANT_GRID)
    levels = np.linspace(low, high, _DETERMINANT_GRID)[1:]
    theta, P1, P2 = (a.ravel() for a in np.meshgrid(angles, levels, levels))
    one, two = joint.sides(theta)
    det = one.torque_gain(P1) * two.stiffness_gain(P2) - two.torque_gain(P2) * one.stiffness_gain(P1)
    taut = (one.force(P1) > 0) & (two.force(P2) > 0)
    return bool((det[taut] > 0).all())


def findings(
    problem: JointProblem, u: Unknowns, joints: Iterable[AntagonistJoint], covariance: Array, converged: bool
) -> Findings:
    """Return the properties that may deserve a warning; `covariance` is that of the unknowns."""
    P, eps = problem.samples.muscles()
    std = dict(zip(problem.names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    return Findings(
        converged=converged,
        failure=monotonicity_failure(u.muscle, float(P.max()), (max(0.0, float(eps.min())), float(eps.max()))),
        determinant_positive=all(_determinant_positive(joint) for joint in joints),
        slack=int((problem.shares(u) < problem.taut_min).sum()),
        hysteresis_share=_hysteresis_share(problem, u),
        std=std,
        rough=max(map(doubt, joints), default=0.0),
        scale_std=None if problem.conventional else _scale_std(problem, u, covariance),
    )


def warnings(problem: JointProblem, x: Array, u: Unknowns, found: Findings) -> tuple[str, ...]:
    """Return the warnings, one sentence each."""
    return (*_of_the_model(problem, x, found), *_of_the_data(problem, u, found))


def _of_the_model(problem: JointProblem, x: Array, found: Findings) -> Iterator[str]:
    if not found.converged:
        yield "the search stopped before it converged"
    bounded = at_bound(x, problem.lower, problem.upper, 1e-5, 1e-2)
    yield from (f"{n} ended at the limit of its search" for n, b in zip(problem.names, bounded, strict=True) if b)
    if found.failure:
        yield f"{FAILS}: {found.failure}"
    if not found.determinant_positive:
        yield "det ∂(T, K)/∂(P1, P2) changes sign: stiffness cannot be commanded everywhere"
    if found.rough > ROUGH:
        yield sentence(found.rough)
    if found.slack and problem.pull is None:  # an assumed pull share implies assumed slack cables
        yield f"{found.slack} of {2 * problem.samples.n} muscle forces are below {problem.taut_min:.0%} of the mean"


def _of_the_data(problem: JointProblem, u: Unknowns, found: Findings) -> Iterator[str]:
    s, zero = problem.samples, u.zero / DEG
    if "zero" in problem.extra and abs(zero) >= _LARGE_ZERO:
        yield (
            f"the encoder's zero would be off by {zero:.3g}°: is the geometry that of the joint, and are the "
            "equilibria at rest and taut? If so, `run` subtracts the zero in the joint's file from all readings"
        )
    elif "zero" in problem.extra and max(abs(zero), 2 * found.std["zero"] / DEG) >= _SOME_ZERO:
        yield (
            f"the encoder's zero of {zero:+.2g}° ± {found.std['zero'] / DEG:.1g}° was told from the balance of the "
            "muscles, where unlike muscles look like a zero: if it is known, hold it by --zero (zero= in Python)"
        )
    yield from _of_the_gravity(problem, u, found.std)
    if "friction" in problem.extra and u.friction < -max(NO_FRICTION, 2 * found.std.get("friction", 0.0)):
        yield f"μ = {u.friction:.3g} is negative: the directions look swapped"
    elif not (s.direction != 0).any():
        yield "no direction of motion: hysteresis, if there is any, sits in the error"
    elif "friction" not in problem.extra and found.hysteresis_share > 0.5:
        yield f"{found.hysteresis_share:.0%} of the squared error is hysteresis: friction=True explains most of it"
    if found.scale_std is not None and found.scale_std >= _POOR_SCALE:
        W = float(np.abs(s.torque).max())
        needed = (
            "hang a known weight"
            if not W
            else f"5 % would take {W * found.scale_std / 0.05:.2g} instead of {W:.2g} N·m, if the joint holds it"
        )
        yield f"K is known to {found.scale_std:.0%} only: {needed}"
    if not problem.conventional and (area := problem.mean_area(u).real) >= _MOST_AREA:
        pull = f"{area * BAR:.3g} N/bar"
        yield f"by the weight the muscles pull with {pull}, more than any is known to: is the torque in N·m?"
    if problem.sag is not None and (error := rms(problem.sag_error(u))) >= _SAG_MISSED * problem.sag.noise:
        yield (
            f"the sag test contradicts the law or the equilibria: its pressures are {error / BAR:.2g} bar from those "
            f"at which the cables go slack here, slack_noise = {problem.sag.noise / BAR:.2g} bar"
        )


def _of_the_gravity(problem: JointProblem, u: Unknowns, std: Mapping[str, float]) -> Iterator[str]:
    """Yield that the rests do not tell a fitted gravity from the muscles."""
    if FITTED_GRAVITY[0] not in problem.extra:
        return
    error, G = hypot(*(std[name] for name in FITTED_GRAVITY)), problem.gravity_of(u).torque
    if error >= _LOST_GRAVITY * G:
        yield (
            f"the gravity of {G:.3g} ± {error:.2g} N·m is not told from the muscles' passive forces, which grow with "
            "the angle as well, and K is as uncertain: weigh the link and give its m g l by --gravity, or fit rests of "
            "the joint with its axis upright"
        )
