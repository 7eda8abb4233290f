"""Plan of the pressures to visit and the weight to hang, for a required accuracy of K.

The unknowns x of the fit have the information matrix M = M0 + Σ Bᵀ B/σ², B the two rows ∂θ_eq/∂x of a setpoint that is
visited from above and from below, M0 a loose prior (five times a parameter's value, 10° of the zero, 0.3 of μ).
`allocator.identification.joint.planning.information` adds setpoints until the RMS of K's standard deviation √(g M⁻¹ gᵀ)
over the unloaded setpoints reaches the required value, and there are three times as many setpoints as unknowns: the
guess differs from the joint, so some setpoints are lost at a stop, and with fewer the fit follows the error of its
force law. A plan has one weight: of plans for several weights, the one with the fewest setpoints that reaches the
accuracy is chosen.

A candidate must be feasible on a joint that differs from the guess, with forces 20 % off and strengths that differ by
10 %. Its angle stays two standard deviations away from the stops, plus the rotation caused by the friction of a real
joint, μ = 0.13, and its stiffness two standard deviations away from zero.
`allocator.identification.joint.planning.information` finds the quantities that equilibria do not determine, and the
measurement that would.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.joint.doubt.discrepancy import RMS_OF_FIELD, ForceField, angle_effect
from allocator.identification.joint.planning.information import (
    Candidates,
    Goal,
    Known,
    Supplement,
    informed,
    modelled,
    sag_table,
    spread,
    supplements,
)
from allocator.identification.joint.problem import JointProblem
from allocator.identification.joint.relative import stiffness_with_gradient
from allocator.identification.joint.report import parameter_jacobian
from allocator.identification.joint.samples import JointSamples
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.units import BAR, DEG

APPROACH = 0.5 * BAR  # distance of a pressure from which a setpoint is approached, without friction
_DEFLECTIONS = (5.0, 8.0, 12.0)  # [deg] by the weights tried, at the middle of the pressures
_MOST_SETPOINTS = 60
LEVELS = 8  # of the pressures
_EXTRA = {"log_ratio": 0.3, "zero": 10 * DEG, "friction": 0.3}
_LOOSE = 5.0  # prior standard deviation of a muscle's parameter, relative
_PER_UNKNOWN = 3  # setpoints: from benchmarks.identification.joint_plan, seeds below 1000
_GUESS, _UNEQUAL = 0.2, 0.1  # relative standard deviations of the forces of the guess and of the ratio of strengths [-]
_FRICTION = 0.13  # measured μ of a joint [-]
_ROOM = 2.0  # standard deviations between an angle and the stops
_LAW = 0.08  # RMS error of a force law relative to its mean force: benchmarks.identification.joint_plan, seeds < 4000
_LOWEST = 1.5 * BAR  # of the default candidates


class Setpoint(NamedTuple):
    """One line of the plan, visited twice."""

    torque: float  # of the weight [N·m], positive if it pulls θ down
    P1: float  # [Pa]
    P2: float  # [Pa]
    falling: float  # expected angle when θ falls into it [rad]
    rising: float  # and when it rises [rad]

    def approach(self, joint: AntagonistJoint) -> float:
        """Return the distance of either pressure [Pa] from which the joint slides into this setpoint with friction.

        Friction resists θ in one direction before and in the other one after, so that the torque changes by twice it.
        """
        theta = (self.falling + self.rising) / 2
        friction = joint.friction_torque(theta, self.P1, self.P2, 1.0)
        one, two = joint.sides(theta)
        gain = min(one.torque_gain(self.P1), -two.torque_gain(self.P2))
        return max(APPROACH, float(2 * friction / (gain * (1 - joint.friction))))


@dataclass(frozen=True)
class JointPlan:
    """Setpoints in the order of the bench, and the expected accuracy."""

    setpoints: tuple[Setpoint, ...]
    weight: float  # torque of the weight [N·m]
    unknowns: int  # of the fit
    accuracy: float  # relative standard deviation of K by the readings' noise [-]
    reached: bool  # whether that meets the requirement
    expected: float  # RMS relative error of K, with a force law wrong by 8 % and friction of unknown form [-]
    approach: float  # distance of a pressure from which the joint slides into every setpoint [Pa]
    further: tuple[Supplement, ...] = ()  # additional measurements, the most informative first

    def __str__(self) -> str:
        """Return the table to follow, and after an empty line the benefit of further measurements."""
        n, usual = len(self.setpoints), _PER_UNKNOWN * self.unknowns
        few = f" are few: with fewer than {usual} a fit follows the errors of its force law."
        away = f"{self.approach / BAR:.1f}"
        enough = ": with fewer it follows the errors of its force law, and some may end at a stop."
        lines = [
            f"{n} setpoints, each visited twice, with a weight of {self.weight:.3g} N·m; K will be known to about "
            f"{self.expected:.0%} for muscles",
            f"that differ by {_LAW:.0%} from their force law, with hysteresis of unknown form; the readings' noise "
            f"alone leaves {self.accuracy:.1%}"
            + ("." if self.reached else ",\nwhich is less accurate than was wanted."),
            f"{n} setpoints for the {self.unknowns} unknowns of the fit{few if n < usual else enough}",
            f"falling: come from a P1 {away} bar higher, then lower P1 to its value (where the supply ends: from a P2",
            f"{away} bar lower, then raise P2); rising: from a P1 {away} bar lower. Take more if friction holds it.",
            "Wait until nothing moves and note θ, P1, P2, the torque (> 0 where it pulls θ down) and the direction.",
            " no.  torque [N·m]  P1 [bar]  P2 [bar]   θ falling   θ rising",
        ]
        lines += [
            f"{i:4d}  {s.torque:+12.3g}  {s.P1 / BAR:8.2f}  {s.P2 / BAR:8.2f}"
            f"  {s.falling / DEG:9.1f}°  {s.rising / DEG:8.1f}°"
            for i, s in enumerate(self.setpoints, 1)
        ]
        return "\n".join([*lines, *self._further()])

    def _further(self) -> list[str]:
        if not self.further:
            return []
        best, *others = self.further
        unseen = "Equilibria do not show a force common to both muscles, hence not where cables go slack. "
        table = sag_table(best.sag) if best.sag else []
        said = f"\n{unseen if best.sag else ''}Most informative in addition:"
        return [said, f"  {best}", *table, *(f"  (or {other})" for other in others)]


def plan_joint_experiment(
    joint: AntagonistJoint,
    *,
    accuracy: float = 0.05,
    noise: float = 0.5 * DEG,
    pressures: ArrayLike | None = None,
    weights: Iterable[float] | None = None,
    setpoints: int | None = None,
    gravity: Gravity = NO_GRAVITY,
) -> JointPlan:
    """Plan the measurement for `fit_joint` on a roughly known `joint` (a guess, a data sheet, a first fit).

    The plan's `further` ranks additional measurements by their information on quantities that the equilibria leave
    open: a sag test, a second weight or a push with shut valves.

    Parameters
    ----------
    accuracy
        Required relative standard deviation of K [-].
    noise
        Standard deviation of one reading of the angle [rad].
    pressures
        Levels [Pa] that both pressures may have; eight from 1.5 bar to the supply by default.
    weights
        Available torques [N·m]; by default those that move the joint by 5°, 8° and 12°.
    setpoints
        Number of setpoints; by default three times the unknowns of the fit, or more if `accuracy` needs them.
    gravity
        The known gravity of the link, which the fit is to be given as well.

    Raises
    ------
    InvalidInput
        For invalid arguments, and for a weight that the joint cannot hold at any setpoint.
    """
    if not 0 < accuracy < 1:
        raise InvalidInput(f"accuracy = {accuracy!r} has to be a share of K, such as 0.05")
    sigma = checks.positive("noise", checks.angle("noise", noise), "rad")
    if setpoints is not None:
        checks.count("setpoints", setpoints, least=2)
    supply = joint.pressure_limits[1]
    levels = np.linspace(min(_LOWEST, supply / 3), supply, LEVELS) if pressures is None else pressures
    P = np.unique(checks.positive_pressure("pressures", levels))
    hung = _weights(joint, weights)
    plans = [_plan(joint, accuracy, sigma, partial(_candidates, joint, gravity, P), float(W), setpoints) for W in hung]
    return min(plans, key=lambda p: (not p.reached, len(p.setpoints) if p.reached else 0, p.expected, p.weight))


def _weights(joint: AntagonistJoint, given: Iterable[float] | None) -> list[float]:
    if given is not None:
        weights = [float(w) for w in given]
        if not weights or not all(0 < w < np.inf for w in weights):
            raise InvalidInput(f"weights = {weights} have to be positive torques [N·m]")
        return weights
    P = sum(joint.pressure_limits) / 2
    theta = sum(joint.angle_range) / 2
    K = float(joint.stiffness(theta, P, P))
    return [float(f"{K * deflection * DEG:.2g}") for deflection in _DEFLECTIONS]


def _plan(
    joint: AntagonistJoint,
    accuracy: float,
    sigma: float,
    candidates_of: Callable[[float], tuple[JointProblem, Array, Array]],
    W: float,
    setpoints: int | None,
) -> JointPlan:
    problem, x, angle = candidates_of(W)
    surviving = _surviving(joint, problem, x, angle)
    problem, angle = problem.on(surviving), angle[surviving]
    T = problem.samples.torque.reshape(2, -1)[0]
    if not T.any():
        raise InvalidInput(f"a weight of {W:g} N·m is more than the joint holds at any of these pressures; hang less")
    B = problem.jacobian(x)[: problem.samples.n].reshape(2, T.size, x.size).swapaxes(0, 1) / sigma  # (setpoints, 2, m)
    loose = [_EXTRA.get(name, _LOOSE * (abs(v) or 1.0)) for name, v in zip(problem.names, x.tolist(), strict=True)]
    before = np.array(loose)  # prior standard deviations (m,) of the unknowns
    field = ForceField.of(problem, problem.unknowns(x))
    goal = _goal(joint, problem, x, angle, T == 0, field)
    candidates = Candidates.of(problem, x, field, before, goal, _LAW, sigma)
    chosen, C, reached = _chosen(candidates, B, before, goal.by_x, accuracy, setpoints)
    twice, there, _ = candidates_of(2 * W)
    held = (twice.samples.torque != 0) & (twice.samples.P1 == twice.samples.P2)
    heavier = twice.jacobian(there)[: twice.samples.n][held]
    further = supplements(joint, Known(problem, x, C, goal.by_x, W, sigma), heavier)
    s = problem.samples
    P1, P2 = s.P1.reshape(2, -1)[0], s.P2.reshape(2, -1)[0]
    falling, rising = angle.reshape(2, -1)
    order = sorted(chosen, key=lambda i: (abs(T[i]), T[i], P1[i], P2[i]))
    points = tuple(Setpoint(*(float(a[i]) for a in (T, P1, P2, falling, rising))) for i in order)
    approach = max(point.approach(joint) for point in points)
    return JointPlan(points, W, x.size, reached, reached <= accuracy, candidates.error(chosen), approach, further)


def _chosen(
    candidates: Candidates, B: Array, before: Array, goal: Array, accuracy: float, setpoints: int | None
) -> tuple[list[int], Array, float]:
    """Return the setpoints, the covariance of x (m, m) by the noise, and the standard deviation of K [-]."""
    m = before.size
    least, most = (_PER_UNKNOWN * m, _MOST_SETPOINTS) if setpoints is None else (setpoints, setpoints)
    chosen: list[int] = []
    C = np.diag(before**2)
    reached = spread(goal, C)
    while (reached > accuracy or len(chosen) < least) and len(chosen) < most:
        best = candidates.following(chosen, m)
        if best is None:
            break
        chosen.append(best)
        C = informed(C, B[best])
        reached = spread(goal, C)
    return chosen, C, reached


def _candidates(joint: AntagonistJoint, gravity: Gravity, levels: Array, W: float) -> tuple[JointProblem, Array, Array]:
    """Return the problem of a fit to all candidates, falling first and then rising, its unknowns, and the angles."""
    P1, P2, T = (a.ravel() for a in np.meshgrid(levels, levels, [0.0, -W, W]))
    n = P1.size
    direction = np.repeat([-1.0, 1.0], n)
    left, right = joint.angle_range
    start = JointSamples.checked(
        np.full(2 * n, (left + right) / 2),
        np.tile(P1, 2),
        np.tile(P2, 2),
        geometry=joint.geometry,
        torque=np.tile(T, 2),
        direction=direction,
    )
    muscle = joint.agonist
    recipe = muscle.recipe(np.array([0.0, 0.2]), np.array([1.0, 5.0]) * BAR, np.array([1.0, 1.0]))
    free = recipe.free(muscle.parameters)
    extra, unbounded = tuple(_EXTRA), np.full(len(free) + len(_EXTRA), np.inf)
    problem = JointProblem(
        muscle,
        free,
        extra,
        -unbounded,
        unbounded,
        start,
        0.02,
        conventional=False,
        gravity=gravity,
        margin=(right - left) / 2,
    )
    P, eps = joint.pressure_limits[1] / 2, 0.1  # where strengths of muscles of one kind are compared
    ratio = float(joint.antagonist.force(P, eps) / muscle.force(P, eps))
    x = np.array([*(muscle.parameters[p] for p in free), np.log(ratio), 0.0, joint.friction])
    angle, there = problem.equilibrium(problem.unknowns(x))
    forces = np.minimum(*problem.balance(problem.unknowns(x), angle).forces)
    good = there & (forces > 0.02 * forces.max()) & (angle > left) & (angle < right)
    both = np.tile(good[:n] & good[n:], 2)
    if not both.any():
        raise InvalidInput("the joint cannot hold itself taut at any of these pressures")
    problem = problem.on(both)
    return replace(problem, samples=replace(problem.samples, theta=angle[both])), x, angle[both]


def _surviving(joint: AntagonistJoint, problem: JointProblem, x: Array, angle: Array) -> Mask:
    """Return the candidates (n,) that stay off the stops on a joint that differs from the guess.

    If they are too few, those with most clearance are taken.
    """
    left, right = joint.angle_range
    by = dict(zip(problem.names, -problem.jacobian(x)[: angle.size].T, strict=True))
    u, s = problem.unknowns(x), problem.samples
    field = ForceField.of(problem, u)
    law = angle_effect(problem, x, field)
    stiff, *_ = field.effects(joint.geometry, u, angle, s.P1, s.P2)
    K = problem.still().balance(u, angle).stiffness
    std = np.sqrt((law**2).sum(axis=1) * (_GUESS / RMS_OF_FIELD) ** 2 + (_UNEQUAL * by["log_ratio"]) ** 2)
    room = np.minimum(angle - left, right - angle) - np.abs(by["friction"]) * max(_FRICTION - joint.friction, 0.0)
    least = np.minimum(room / std, K / np.sqrt((stiff**2).sum(axis=1)) * RMS_OF_FIELD / _GUESS)
    share = least.reshape(2, -1).min(axis=0)
    enough = min(3 * x.size, share.size)
    return np.tile(share >= min(_ROOM, np.sort(share)[-enough]), 2)


def _goal(
    joint: AntagonistJoint, problem: JointProblem, x: Array, angle: Array, unloaded: Array, field: ForceField
) -> Goal:
    """Return the gradients of log K at the unloaded setpoints."""
    u, s = problem.unknowns(x), problem.samples
    here = np.concatenate([unloaded, np.zeros(unloaded.size, bool)])
    K = stiffness_with_gradient(modelled(joint, u), angle[here], s.P1[here], s.P2[here])
    by_law, *_ = field.effects(joint.geometry, u, angle[here], s.P1[here], s.P2[here])
    return Goal(K.gradient / K.value[:, None] @ parameter_jacobian(problem, u), by_law / K.value[:, None])
