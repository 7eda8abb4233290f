"""A plan says which pressures to visit and which weight to hang so that K is known to a wanted accuracy: a D-optimal
plan.

The unknowns x of the fit have the information matrix M = M0 + Σ Bᵀ B/σ², B the two rows ∂θ_eq/∂x of a setpoint that is
visited from above and from below, M0 a loose prior (a parameter is known to five times itself, the zero to 10°, μ to
0.3). At each step the setpoint with the greatest gain log det(I + B M⁻¹ Bᵀ/σ²) is added, until the standard deviation
of K over the unloaded setpoints, √(g M⁻¹ gᵀ) in the mean square, is what is wanted, and there are as many setpoints as
unknowns. A plan has one weight: plans are made for several, and the one with the fewest setpoints is taken. What
equilibria do not show, and which further measurement would show it, is in
`allocator.identification.joint.planning.supplements`.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.identification.joint import gradients
from allocator.identification.joint.planning.supplements import Known, Supplement, sag_table, supplements
from allocator.identification.joint.problem import JointProblem
from allocator.identification.joint.report import parameter_jacobian
from allocator.identification.joint.samples import JointSamples
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles import scaled
from allocator.units import BAR, DEG

_DEFLECTIONS = (5.0, 8.0, 12.0)  # [deg] that the weights tried make at the middle of the pressures
_MOST_SETPOINTS = 60
_EXTRA = {"log_ratio": 0.3, "zero": 10 * DEG, "friction": 0.3}
_LOOSE = 5.0  # times itself: what is known of a muscle's parameter beforehand
_LOWEST = 1.5 * BAR  # of the default candidates


class Setpoint(NamedTuple):
    """A setpoint is one line of the plan, visited twice."""

    torque: float  # of the weight [N·m], positive where it pulls θ down
    P1: float  # [Pa]
    P2: float  # [Pa]
    falling: float  # angle to be expected when θ falls into it [rad]
    rising: float  # and when it rises [rad]


@dataclass(frozen=True)
class JointPlan:
    """A plan lists setpoints in the order of the bench, and the accuracy to be expected."""

    setpoints: tuple[Setpoint, ...]
    weight: float  # torque of the weight [N·m]
    accuracy: float  # relative standard deviation of K to be expected [-]
    reached: bool  # whether that is what was wanted
    further: tuple[Supplement, ...] = ()  # measurements beside them, the one that tells most first

    def __str__(self) -> str:
        """Return the table to follow, and after an empty line what a further measurement would tell."""
        head = (
            f"{len(self.setpoints)} setpoints, each visited twice, with a weight of {self.weight:.3g} N·m; K will be "
            f"known to {self.accuracy:.1%}" + ("" if self.reached else ", which is less than was wanted") + ",\n"
            "if the readings' noise is all that errs: what the muscles do besides their model comes on top."
        )
        how = (
            "falling: come from a P1 0.5 bar higher, then lower P1 to its value (where the supply ends: from a P2\n"
            "0.5 bar lower, then raise P2); rising: from a P1 0.5 bar lower.\n"
            "Wait until nothing moves and note θ, P1, P2, the torque (> 0 where it pulls θ down) and the direction."
        )
        rows = [" no.  torque [N·m]  P1 [bar]  P2 [bar]   θ falling   θ rising"]
        rows += [
            f"{i:4d}  {s.torque:+12.3g}  {s.P1 / BAR:8.2f}  {s.P2 / BAR:8.2f}"
            f"  {s.falling / DEG:9.1f}°  {s.rising / DEG:8.1f}°"
            for i, s in enumerate(self.setpoints, 1)
        ]
        return "\n".join([head, how, *rows, *self._further()])

    def _further(self) -> list[str]:
        if not self.further:
            return []
        best, *others = self.further
        why = (
            "Equilibria do not show a force common to both muscles, hence not where cables go slack. "
            if best.sag
            else ""
        )
        table = sag_table(best.sag) if best.sag else []
        return [f"\n{why}What tells most beside them:", f"  {best}", *table, *(f"  (or {other})" for other in others)]


def plan_joint_experiment(
    joint: AntagonistJoint,
    *,
    accuracy: float = 0.05,
    noise: float = 0.5 * DEG,
    pressures: Any = None,
    weights: Iterable[float] | None = None,
) -> JointPlan:
    """Plan the measurement for `fit_joint` on a roughly known `joint` (a guess, a data sheet, a first fit).

    The plan's `further` says which measurement beside the equilibria tells most of what they leave open: a sag test, a
    second weight or a push with shut valves.

    Parameters
    ----------
    accuracy
        Relative standard deviation of K that is wanted [-].
    noise
        Standard deviation of one reading of the angle [rad].
    pressures
        Levels [Pa] that both pressures may have; six from 1.5 bar to the supply by default.
    weights
        Torques [N·m] that can be hung; by default those that move the joint by 5°, 8° and 12°.

    Raises
    ------
    InvalidInput
        For what cannot be, and for a weight that the joint holds nowhere.
    """
    if not 0 < accuracy < 1:
        raise InvalidInput(f"accuracy = {accuracy!r} has to be a share of K, such as 0.05")
    sigma = float(checks.angle("noise", noise))
    if not sigma > 0:
        raise InvalidInput(f"noise = {noise!r} rad has to be positive")
    supply = joint.pressure_limits[1]
    levels = np.linspace(min(_LOWEST, supply / 3), supply, 6) if pressures is None else pressures
    P = np.unique(checks.positive_pressure("pressures", levels))
    plans = [_plan(joint, accuracy, sigma, P, float(W)) for W in _weights(joint, weights)]
    return min(plans, key=lambda plan: (not plan.reached, len(plan.setpoints), plan.accuracy, plan.weight))


def _weights(joint: AntagonistJoint, given: Iterable[float] | None) -> list[float]:
    if given is not None:
        weights = [float(w) for w in given]
        if not weights or min(weights) <= 0:
            raise InvalidInput(f"weights = {weights} have to be positive torques [N·m]")
        return weights
    P = sum(joint.pressure_limits) / 2
    theta = sum(joint.angle_range) / 2
    K = float(joint.stiffness(theta, P, P))
    return [float(f"{K * deflection * DEG:.2g}") for deflection in _DEFLECTIONS]


def _plan(joint: AntagonistJoint, accuracy: float, sigma: float, levels: Array, W: float) -> JointPlan:
    problem, x, angle = _candidates(joint, levels, W)
    B = problem.jacobian(x)[: problem.samples.n].reshape(2, -1, x.size).swapaxes(0, 1) / sigma  # (setpoints, 2, m)
    T = problem.samples.torque.reshape(2, -1)[0]
    if not T.any():
        raise InvalidInput(f"a weight of {W:g} N·m is more than the joint holds at any of these pressures; hang less")
    C, goal = _prior(problem, x), _goal(joint, problem, x, angle, T == 0)
    chosen: list[int] = []
    reached = _accuracy(goal, C)
    while (reached > accuracy or len(chosen) < x.size) and len(chosen) < _MOST_SETPOINTS:
        inner = np.eye(2) + B @ C @ B.swapaxes(1, 2)
        gain = np.linalg.slogdet(inner)[1]
        gain[chosen] = -np.inf  # a setpoint visited again would show the model's error, not the noise
        if not np.isfinite(gain.max()):
            break
        best = int(gain.argmax())
        chosen.append(best)
        C = C - C @ B[best].T @ np.linalg.solve(inner[best], B[best] @ C)
        reached = _accuracy(goal, C)
    further = supplements(joint, Known(problem, x, C, goal, W, sigma), _heavier(joint, levels, 2 * W))
    s = problem.samples
    P1, P2 = s.P1.reshape(2, -1)[0], s.P2.reshape(2, -1)[0]
    falling, rising = angle.reshape(2, -1)
    order = sorted(chosen, key=lambda i: (abs(T[i]), T[i], P1[i], P2[i]))
    points = tuple(Setpoint(*(float(a[i]) for a in (T, P1, P2, falling, rising))) for i in order)
    return JointPlan(points, W, reached, reached <= accuracy, further)


def _heavier(joint: AntagonistJoint, levels: Array, W: float) -> Array:
    """Return ∂θ_eq/∂x (r, m) of equilibria under the weight W at equal pressures that hold it, from both sides."""
    problem, x, _ = _candidates(joint, levels, W)
    s = problem.samples
    here = (s.torque != 0) & (s.P1 == s.P2)
    return np.asarray(problem.jacobian(x)[: s.n][here])


def _candidates(joint: AntagonistJoint, levels: Array, W: float) -> tuple[JointProblem, Array, Array]:
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
    held = muscle.recipe(np.array([0.0, 0.2]), np.array([1.0, 5.0]) * BAR, np.array([1.0, 1.0])).conventional
    free = tuple(p for p in muscle.parameters if not {p, p.partition("[")[0]} & set(held))
    extra, unbounded = tuple(_EXTRA), np.full(len(free) + len(_EXTRA), np.inf)
    problem = JointProblem(
        muscle, free, extra, -unbounded, unbounded, start, 0.02, conventional=False, margin=(right - left) / 2
    )
    x = np.array([*(muscle.parameters[p] for p in free), np.log(_ratio(joint)), 0.0, joint.friction])
    angle, there = problem.equilibrium(problem.unknowns(x))
    forces = np.minimum(*problem.balance(problem.unknowns(x), angle).forces)
    good = there & (forces > 0.02 * forces.max()) & (angle > left) & (angle < right)
    both = np.tile(good[:n] & good[n:], 2)
    if not both.any():
        raise InvalidInput("the joint cannot hold itself taut at any of these pressures")
    return problem.on(both), x, angle[both]


def _ratio(joint: AntagonistJoint) -> float:
    """Return the strength of the antagonist in that of the agonist, if it is of the same kind.

    It is told by the forces at half the supply.
    """
    P, eps = joint.pressure_limits[1] / 2, 0.1
    return float(joint.antagonist.force(P, eps) / joint.agonist.force(P, eps))


def _prior(problem: JointProblem, x: Array) -> Array:
    loose = [_EXTRA.get(name, _LOOSE * (abs(v) or 1.0)) for name, v in zip(problem.names, x.tolist(), strict=True)]
    return np.diag(np.square(loose))


def _goal(joint: AntagonistJoint, problem: JointProblem, x: Array, angle: Array, unloaded: Array) -> Array:
    """Return ∂(log K)/∂x (k, m) at the unloaded setpoints."""
    u, s = problem.unknowns(x), problem.samples
    here = np.concatenate([unloaded, np.zeros(unloaded.size, bool)])
    modelled = AntagonistJoint(
        joint.geometry, u.muscle, scaled(u.muscle, u.ratio), joint.pressure_limits, joint.min_contraction
    )
    K = gradients.stiffness(modelled, angle[here], s.P1[here], s.P2[here])
    return np.asarray(K.gradient / K.value[:, None] @ parameter_jacobian(problem, u))


def _accuracy(goal: Array, C: Array) -> float:
    return float(np.sqrt(np.mean(np.einsum("ki,ij,kj->k", goal, C, goal))))


__all__ = ["JointPlan", "Setpoint", "plan_joint_experiment"]
