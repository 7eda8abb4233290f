"""The formulas that the governor asks are written here: forces, torques, energy, the work up to the ends."""

from collections.abc import Iterator
from typing import Any

from allocator.calculus import Array
from allocator.mechanism import Mechanism
from mpc.arm.lengths import symbolic_lengths

PER_END = 3  # postures with a joint at an end: the others where they are, and where two commands settle them


def points(n: int) -> int:
    """Return how many postures at the ends are looked at: where the others settle, least work is in the way."""
    return 2 * n * (PER_END if n > 1 else 1)


def ways_function(mechanism: Mechanism, ends: Array, nearest: float, inertia: Any, load: Array, lag: float) -> Any:
    """Return the CasADi function (q, ω, P, last, aim) ↦ the columns of `mpc.governor.kernel.Ways`.

    The next command is expected near the `last` one or what is aimed at, `aim` (m). Matrices come row by row. `ends`
    (n, 2) [rad] are those of each joint; the way to one is at least `nearest` [rad].
    `inertia` is M (n, n) [kg·m²], or a function q ↦ M of CasADi expressions; `load` (n) [N·m]; `lag` [s]. Raises
    `InvalidInput` for muscles that are not affine and for routes without formulas.
    """
    import casadi as ca

    mechanism.check_affine("a governor")
    n, m = mechanism.n, mechanism.m
    q, omega = ca.SX.sym("q", n), ca.SX.sym("omega", n)
    P, last, aim = ca.SX.sym("P", m), ca.SX.sym("last", m), ca.SX.sym("aim", m)
    length = symbolic_lengths(mechanism.routes, q)
    lengths = ca.Function("lengths", [q], [length])
    gain, force = _muscles(mechanism, length)
    arms = -ca.jacobian(length, q).T  # (n, m)
    torque_gain, torque = arms @ ca.diag(gain), arms @ force  # (M1)
    now = torque_gain @ P + torque
    M = ca.SX(inertia(q)) if callable(inertia) else ca.SX(ca.DM(inertia))
    K = -ca.jacobian(now, q)  # (M2)
    passed = ca.solve(M + lag**2 * K, lag * (M @ omega) + lag**2 * now)
    work_gain, work, reach = [], [], []
    for far, other in _at_the_ends(q, (last, aim), ends, nearest, ca.Function("torque", [q, P], [now])):
        A, B = _work(mechanism, length, lengths(other))
        work_gain.append(A.T / far)
        work.append((B + ca.dot(ca.fabs(other - q), load)) / far)
        reach.append(far)
    made = [gain, force, ca.vec(torque_gain.T), torque, now, passed, 0.5 * ca.dot(omega, M @ omega)]
    made += [ca.vec(ca.vertcat(*work_gain).T), ca.vertcat(*work), ca.vertcat(*reach)]
    names = ["gain", "force", "torque_gain", "torque", "now", "passed", "kinetic", "work_gain", "work", "way"]
    return ca.Function(
        "ways", [q, omega, P, last, aim], list(map(ca.densify, ca.cse(made))), ["q", "omega", "P", "last", "aim"], names
    )


def _muscles(mechanism: Mechanism, length: Any) -> tuple[Any, Any]:
    """Return A (m) and B (m) of the forces A P + B at these lengths (m, 1)."""
    import casadi as ca

    rests = mechanism.routes.rest_length
    eps = [(L - length[j]) / L for j, L in enumerate(rests)]
    pairs = list(zip(mechanism.muscles, eps, strict=True))
    A = ca.vertcat(*(muscle.gain(0.0, e) for muscle, e in pairs))
    return A, ca.vertcat(*(muscle.law(0.0, e) for muscle, e in pairs))


def _work(mechanism: Mechanism, length: Any, other: Any) -> tuple[Any, Any]:
    """Return the muscles' work ∫ F (-dl) from one posture to the other, per pressure (m) and without.

    Simpson's rule along each muscle's length, exact where A and B are cubics of it.
    """
    import casadi as ca

    ends = [_muscles(mechanism, at) for at in (length, (length + other) / 2, other)]
    A, B = ((first + 4 * middle + last) / 6 for first, middle, last in zip(*ends, strict=True))
    return A * (length - other), ca.dot(B, length - other)


def _at_the_ends(q: Any, held: Any, ends: Array, nearest: float, torque: Any) -> Iterator[tuple[Any, Any]]:
    """Yield (how far it is, the posture) of `PER_END` postures with a joint at an end, for each.

    `held` are two of pressures (m, 1), `torque` is the CasADi function (q, P) ↦ τ.
    """
    import casadi as ca

    n = len(ends)
    for i in range(n):
        for sign in (-1, 1):
            far = ca.fmax(sign * (ends[i, max(sign, 0)] - q[i]), nearest)
            posture = ca.SX(q)
            posture[i] = q[i] + sign * far
            yield far, posture
            if n > 1:
                yield from ((far, _settled(posture, pressures, i, ends, torque)) for pressures in held)


def _settled(posture: Any, P: Any, i: int, ends: Array, torque: Any) -> Any:
    """Return where the joints but `i` settle with pressures `P`, after two steps of Newton's method within the ends."""
    import casadi as ca

    q, held = ca.SX.sym("q", len(ends)), ca.SX.sym("P", P.numel())
    low, high = ca.DM(ends[:, 0]), ca.DM(ends[:, 1])
    others = [k for k in range(len(ends)) if k != i]
    pulls = torque(q, held)
    at = ca.Function("at", [q, held], [pulls[others], -ca.jacobian(pulls, q)[others, others]])
    for _ in range(2):
        pull, K = at(posture, P)
        posture = ca.SX(posture)
        moved = posture[others] + ca.solve(K, pull)
        posture[others] = ca.fmin(ca.fmax(moved, low[others]), high[others])
    return posture


__all__ = ["points", "ways_function"]
