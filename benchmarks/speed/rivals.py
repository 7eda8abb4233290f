"""General optimisers on the same allocation problem, in lean code.

All work in bar and start from the middle of the box. They receive the box, and the torque within reach, for free. SLSQP
and IPOPT minimise (K - K*)² subject to T = T*; least_squares, which has no constraints, minimises W (T - T*)² +
(K - K*)², approximately torque first.
"""

from collections.abc import Callable

import casadi
import numpy as np
from scipy.optimize import least_squares, minimize

from allocator import AntagonistJoint, torque_interval
from allocator.muscles import Tondu2021
from allocator.units import BAR
from benchmarks.speed.targets import Array, Targets

W = 1e3  # [(N·m/rad)²/(N·m)²]
Rival = Callable[[int], Array]  # the number of a target → (P1, P2) [Pa]


class Problems:
    """Targets as optimisation problems in bar: manual gradients, no checks, plain floats."""

    def __init__(self, targets: Targets) -> None:
        self.joint: AntagonistJoint = targets.joint
        muscle, pulley = targets.joint.agonist, targets.joint.geometry
        assert isinstance(muscle, Tondu2021)
        self.muscle, self.R, self.l0, self.eps0 = muscle, pulley.radius, pulley.rest_length, pulley.initial_contraction
        theta = np.clip(targets.theta, *targets.joint.angle_range)
        box = targets.joint.pressure_box(theta)
        self.theta = theta.tolist()
        self.X = (self.R * theta / self.l0).tolist()
        reachable = torque_interval(theta, joint=targets.joint)
        self.K, self.T = targets.K.tolist(), np.clip(targets.T, *reachable).tolist()
        self.lo = (np.stack([box.agonist.lo, box.antagonist.lo], 1) / BAR).tolist()
        self.hi = (np.stack([box.agonist.hi, box.antagonist.hi], 1) / BAR).tolist()

    def middle(self, i: int) -> list[float]:
        """Return the common starting point."""
        return [(a + b) / 2 for a, b in zip(self.lo[i], self.hi[i], strict=True)]

    def bounds(self, i: int) -> list[tuple[float, float]]:
        """[(lo1, hi1), (lo2, hi2)] [bar]."""
        return list(zip(self.lo[i], self.hi[i], strict=True))

    def errors(self, p: Array, i: int) -> tuple[float, float]:
        """(T - T*, K - K*)."""
        m, X = self.muscle, self.X[i]
        P1, P2 = p[0] * BAR, p[1] * BAR
        r1, r2 = 1 / (P1 + m.d), 1 / (P2 + m.d)
        q, S, R = m.a - m.b, m.S, self.R
        T = S * R * (q * (P1 - P2) - 2 * m.c * X - m.g * ((self.eps0 + X) * r1 - (self.eps0 - X) * r2))
        return T - self.T[i], S * R * R / self.l0 * (2 * m.c + m.g * (r1 + r2)) - self.K[i]

    def slopes(self, p: Array, i: int) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return their derivatives with respect to both pressures [1/bar]."""
        m, X = self.muscle, self.X[i]
        r1, r2 = 1 / (p[0] * BAR + m.d), 1 / (p[1] * BAR + m.d)
        q, push, stretch = m.a - m.b, m.S * self.R * BAR, -m.S * self.R**2 / self.l0 * m.g * BAR
        T1, T2 = q + m.g * (self.eps0 + X) * r1 * r1, q + m.g * (self.eps0 - X) * r2 * r2
        return (push * T1, -push * T2), (stretch * r1 * r1, stretch * r2 * r2)


def slsqp(problems: Problems) -> Rival:
    """Return SciPy's SLSQP with gradients."""

    def solve(i: int) -> Array:
        torque = {
            "type": "eq",
            "fun": lambda p: problems.errors(p, i)[0],
            "jac": lambda p: np.array(problems.slopes(p, i)[0]),
        }
        found = minimize(
            lambda p: problems.errors(p, i)[1] ** 2,
            problems.middle(i),
            jac=lambda p: 2 * problems.errors(p, i)[1] * np.array(problems.slopes(p, i)[1]),
            method="SLSQP",
            bounds=problems.bounds(i),
            constraints=torque,
            options={"ftol": 1e-12},
        )
        return np.asarray(found.x) * BAR

    return solve


def trust_region(problems: Problems) -> Rival:
    """Return SciPy's least_squares (trust region reflective) with its Jacobian."""

    def residual(p: Array, i: int) -> Array:
        e_T, e_K = problems.errors(p, i)
        return np.array([W**0.5 * e_T, e_K])

    def jacobian(p: Array, i: int) -> Array:
        t, k = problems.slopes(p, i)
        return np.array([[W**0.5 * t[0], W**0.5 * t[1]], k])

    def solve(i: int) -> Array:
        lo, hi = np.array(problems.lo[i]), np.array(problems.hi[i]) + 1e-9
        found = least_squares(residual, problems.middle(i), jacobian, (lo, hi), xtol=1e-10, ftol=1e-10, args=(i,))
        return np.asarray(found.x) * BAR

    return solve


def ipopt(problems: Problems) -> Rival:
    """Return CasADi and IPOPT: one parametric solver, built once."""
    p, theta, K, T = casadi.MX.sym("p", 2), casadi.MX.sym("theta"), casadi.MX.sym("K"), casadi.MX.sym("T")
    sides = problems.joint.sides(theta)
    e_T = sides[0].torque(p[0] * BAR) + sides[1].torque(p[1] * BAR) - T
    e_K = sides[0].stiffness(p[0] * BAR) + sides[1].stiffness(p[1] * BAR) - K
    nlp = {"x": p, "p": casadi.vertcat(theta, K, T), "f": e_K**2, "g": e_T}
    solver = casadi.nlpsol("allocation", "ipopt", nlp, {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}})

    def solve(i: int) -> Array:
        asked = [problems.theta[i], problems.K[i], problems.T[i]]
        found = solver(x0=problems.middle(i), p=asked, lbx=problems.lo[i], ubx=problems.hi[i], lbg=0, ubg=0)
        return np.asarray(found["x"]).ravel() * BAR

    return solve


RIVALS = {"SciPy SLSQP": slsqp, "SciPy least_squares": trust_region, "CasADi + IPOPT": ipopt}
