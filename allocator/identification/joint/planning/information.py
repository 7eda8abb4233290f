"""Information in planned measurements: the error of K after a fit to setpoints, and further measurements compared.

A least-squares fit to the visits of the chosen setpoints estimates y = (dx, b), the unknowns and the friction error of
`allocator.identification.joint.doubt.discrepancy`, from θ = R y + B c + e with the error c of the law assumed zero.
With y in units of its prior standard deviations and R, B over σ, the error of the quantity G_y y + G_c c has

    E[error²] = Σ (τ (G_c - G_y S Rᵀ B))² + G_y S G_yᵀ,   S = (I + Rᵀ R)⁻¹                             (E1)

The first part does not decrease with the number of readings, but depends on the positions of setpoints. The greedy
choice takes the greatest gain log det(I + R_i S R_iᵀ) until there are as many setpoints as unknowns, and then the
setpoint that minimises the mean of (E1) over the unloaded setpoints.

In addition to the unknowns x of the fit there is a force common to both muscles, ΔF_i = τ F̄ ā/a_i(θ): a1 ΔF1 = a2 ΔF2
at every angle, so no equilibrium, weight or stiffness determines τ. Before a further measurement it is known to ± 1, or
to ± 0.05 if the joint's fit has determined it. Three measurements are compared by the rows B that they add to the
information matrix, C' = C - C Bᵀ (I + B C Bᵀ)⁻¹ B C:

    sag test     ∂P_i/∂(x, τ)/σ_P     both pressures are lowered until the cables go slack, F_i(P_i, ε_i) = 0
    second weight   ∂θ_eq/∂(x, τ)/σ   equilibria under twice the weight
    push         ∂(log K)/∂(x, τ)/σ_K   with shut valves; σ_K = 10 %, since the gas volume has to be known

The most informative one has the greatest gain log(before/after) of the standard deviation of K, and also of F while τ
is undetermined.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, increasing_root
from allocator.identification.joint.doubt.discrepancy import RMS_OF_FIELD, ForceField, FrictionError, angle_effect
from allocator.identification.joint.problem import JointProblem, Unknowns
from allocator.identification.least_squares import rms
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles import force_gradient, scaled
from allocator.muscles.uncertainty import deviation
from allocator.units import BAR, DEG

_SLACK_NOISE = 0.1 * BAR  # σ_P [Pa]
_PUSH_NOISE = 0.1  # σ_K, relative [-]
_ANGLES = 5  # of the sag test
_INNER = 0.8  # of the angle range, which contains them
_SEEN, _UNSEEN = 0.05, 1.0  # prior standard deviation of τ [-]
_FRICTION = 0.1  # prior standard deviation of b [rad]


class SagPoint(NamedTuple):
    """Angle of the held joint, and the pressures at which its cables go slack."""

    theta: float  # [rad]
    P1: float  # [Pa]; NaN if the agonist pulls without pressure
    P2: float  # [Pa]

    @property
    def slack(self) -> int:
        """Return the code of the column `slack`: 1 the agonist goes slack, 2 the antagonist, 3 both."""
        return int(np.isfinite(self.P1)) + 2 * int(np.isfinite(self.P2))


class Supplement(NamedTuple):
    """Further measurement and its expected benefit; standard deviations are relative [-]."""

    name: str
    how: str  # instructions
    forces: float  # of the mean muscle force, afterwards
    stiffness: float  # of K, afterwards
    gain: float  # log(before/after)
    sag: tuple[SagPoint, ...] = ()
    weight: float = 0.0  # [N·m]

    def __str__(self) -> str:
        """Return one line."""
        forces = f"forces to ± {self.forces:.0%}" if self.forces < _UNSEEN else "forces not seen"
        return f"{self.name}: {forces}, K to ± {self.stiffness:.1%}; {self.how}"


class Known(NamedTuple):
    """Knowledge after the plan: the problem of its candidates and the covariance of its unknowns."""

    problem: JointProblem
    x: Array
    covariance: Array  # (m, m)
    goal: Array  # ∂(log K)/∂x (k, m)
    weight: float  # [N·m]
    noise: float  # of an angle [rad]


def supplements(joint: AntagonistJoint, known: Known, heavier: Array) -> tuple[Supplement, ...]:
    """Return the further measurements, the most informative first.

    `heavier` is ∂θ_eq/∂x (r, m) of equilibria under twice the weight; none if the joint cannot hold it.
    """
    m = known.x.size
    C = np.zeros((m + 1, m + 1))
    C[:m, :m], C[m, m] = known.covariance, (_SEEN if force_seen(joint) else _UNSEEN) ** 2
    K_goal, F_goal = np.pad(known.goal, ((0, 0), (0, 1))), _force_goal(known)
    before = spread(F_goal, C), spread(K_goal, C)

    def told(name: str, how: str, B: Array, **more: object) -> Supplement:
        after = informed(C, B)
        F, K = spread(F_goal, after), spread(K_goal, after)
        gain = np.log(before[1] / K) + (0.0 if force_seen(joint) else np.log(before[0] / F))
        return Supplement(name, how, F, K, float(gain), **more)  # type: ignore[arg-type]  # sag and weight

    found = []
    points, rows = _sag_test(joint, known)
    if points:
        how = "hold the joint at each angle and lower P1 and P2 until the cables just go slack"
        found.append(told("a sag test", how, rows, sag=points))
    if len(heavier):
        how = f"hang {2 * known.weight:.3g} N·m as well, at equal pressures"
        B = np.pad(heavier / known.noise, ((0, 0), (0, 1)))
        found.append(told("a second weight", how, B, weight=2 * known.weight))
    how = "shut the valves, push the joint by a degree and measure the torque; subtract the gas stiffness"
    found.append(told("a push with shut valves", how, K_goal[:: max(1, len(K_goal) // 3)] / _PUSH_NOISE))
    return tuple(sorted(found, key=lambda s: -s.gain))


def informed(C: Array, B: Array) -> Array:
    """Return the covariance C (m, m) after measurements with the rows B (r, m)."""
    return np.asarray(C - C @ B.T @ np.linalg.solve(np.eye(len(B)) + B @ C @ B.T, B @ C))


def modelled(joint: AntagonistJoint, u: Unknowns) -> AntagonistJoint:
    """Return the joint with the muscles of the unknowns."""
    return AntagonistJoint(
        joint.geometry, u.muscle, scaled(u.muscle, u.ratio), joint.pressure_limits, joint.min_contraction
    )


def force_seen(joint: AntagonistJoint) -> bool:
    """Return whether the joint was fitted to data that determine the force common to both muscles."""
    return joint.covariance is not None and not joint.slack_assumed


def spread(goal: Array, C: Array) -> float:
    """Return the root mean square over the rows of `goal` (k, m) of the standard deviations by C (m, m)."""
    return rms(deviation(goal, C))


def _force_goal(known: Known) -> Array:
    """Return ∂(mean force)/∂(x, τ) (1, m + 1), relative, over the candidates without friction."""
    problem, x = known.problem, known.x
    F = problem.measured_forces(problem.unknowns(x))
    steps = np.maximum(1e-6 * np.abs(x), 1e-9)
    slope = [
        (problem.measured_forces(problem.unknowns(x + h * unit)) - F).mean() / h
        for h, unit in zip(steps, np.eye(x.size), strict=True)
    ]
    return np.asarray(np.append(slope, F.mean())[None] / F.mean())


def _sag_test(joint: AntagonistJoint, known: Known) -> tuple[tuple[SagPoint, ...], Array]:
    """Return the points of a sag test, and its rows of the information (r, m + 1)."""
    left, right = joint.angle_range
    angles = (left + right) / 2 + _INNER * (right - left) / 2 * np.linspace(-1, 1, _ANGLES)
    u, problem = known.problem.unknowns(known.x), known.problem
    mean = float(problem.measured_forces(u).mean())
    pressures, rows = [], []
    sides = modelled(joint, u).sides(angles)
    arm = np.mean([side.moment_arm for side in sides])
    for side, strength in zip(sides, (1.0, u.ratio), strict=True):
        low, high = (np.full(_ANGLES, end) for end in joint.pressure_limits)
        eps = np.asarray(side.contraction)
        P = increasing_root(lambda P, eps, m=side.muscle: m.law(P, eps), low, high, eps)
        pressures.append(P)
        for i in np.flatnonzero(np.isfinite(P)).tolist():
            gain = float(side.muscle.gain(P[i], eps[i]))
            dF = np.zeros(known.x.size + 1)
            dF[: len(problem.free)] = strength * force_gradient(u.muscle, P[i], eps[i], problem.free)
            dF[-1] = mean * arm / np.asarray(side.moment_arm)[i]
            rows.append(-dF / gain / _SLACK_NOISE)
    P1, P2 = (np.where(np.isfinite(P), P, np.nan).tolist() for P in pressures)
    points = [SagPoint(*values) for values in zip(angles.tolist(), P1, P2, strict=True)]
    return tuple(p for p in points if p.slack), np.array(rows).reshape(-1, known.x.size + 1)


def sag_table(points: tuple[SagPoint, ...]) -> list[str]:
    """Return the lines of a sag test."""
    lines = ["        θ   P1 slack [bar]   P2 slack [bar]"]
    shown = ("        -" if np.isnan(P) else f"{P / BAR:9.2f}" for p in points for P in (p.P1, p.P2))
    return lines + [f"{p.theta / DEG:8.1f}°  {next(shown):>14s}   {next(shown):>14s}" for p in points]


class Goal(NamedTuple):
    """Gradients of log K at the unloaded setpoints."""

    by_x: Array  # (g, m)
    by_law: Array  # (g, k)


@dataclass(frozen=True)
class Candidates:
    """Model (E1) of n candidate setpoints, each visited from both sides."""

    rows: Array  # R (n, 2, p)
    law: Array  # τ B (n, 2, k)
    by_y: Array  # G_y (g, p)
    by_law: Array  # τ G_c (g, k)

    @classmethod
    def of(
        cls, problem: JointProblem, x: Array, field: ForceField, std: Array, goal: Goal, law: float, noise: float
    ) -> "Candidates":
        """Return the model of the samples of `problem`: all setpoints as they fall, then all as they rise.

        `std` (m,) are the prior standard deviations of x, `law` the RMS error of the law relative to its mean force [-]
        and `noise` σ [rad].
        """
        s = problem.samples
        X = -problem.jacobian(x)[: s.n] * std
        N = FrictionError.of(s).columns(s) * _FRICTION
        tau = law / RMS_OF_FIELD
        return cls(
            _paired(np.hstack([X, N]) / noise),
            _paired(angle_effect(problem, x, field) * tau / noise),
            np.pad(goal.by_x * std, ((0, 0), (0, N.shape[1]))),
            goal.by_law * tau,
        )

    def error(self, chosen: list[int]) -> float:
        """Return the RMS error of K [-] after a fit to these setpoints."""
        R, B = (a[chosen].reshape(-1, a.shape[2]) for a in (self.rows, self.law))
        return float(self._errors((np.eye(R.shape[1]) + R.T @ R)[None], (R.T @ B)[None])[0])

    def following(self, chosen: list[int], unknowns: int) -> int | None:
        """Return the setpoint to choose next, or None if all are chosen."""
        if len(chosen) == len(self.rows):
            return None
        R, B = (a[chosen].reshape(-1, a.shape[2]) for a in (self.rows, self.law))
        A, transposed = np.eye(R.shape[1]) + R.T @ R, self.rows.swapaxes(1, 2)
        if len(chosen) < unknowns:
            gain = np.linalg.slogdet(np.eye(2) + self.rows @ np.linalg.solve(A, transposed))[1]
        else:
            gain = -self._errors(A + transposed @ self.rows, R.T @ B + transposed @ self.law)
        gain[chosen] = -np.inf  # a repeated setpoint would reveal the model's error, not the noise
        return int(gain.argmax())

    def _errors(self, A: Array, seen: Array) -> Array:
        """Return the RMS of (E1) (q,) for the matrices I + Rᵀ R (q, p, p) and τ Rᵀ B (q, p, k)."""
        of_noise = np.linalg.solve(A, np.broadcast_to(self.by_y.T, (len(A), *self.by_y.T.shape)))  # S G_yᵀ
        of_law = self.by_law - of_noise.swapaxes(1, 2) @ seen
        noise = (self.by_y.T * of_noise).sum(axis=1)
        return np.asarray(np.sqrt(np.mean((of_law**2).sum(axis=2) + noise, axis=1)))


def _paired(rows: Array) -> Array:
    return rows.reshape(2, -1, rows.shape[1]).swapaxes(0, 1)
