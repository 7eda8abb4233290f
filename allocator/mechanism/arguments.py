"""`problem_from` turns the arguments of `allocate_mechanism` into a `MechanismProblem`, and checks them."""

from typing import Any

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.gas import ISOBARIC, StiffnessKind
from allocator.joint.limits import Limits
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.problem import PRIORITIES, MechanismProblem
from allocator.mechanism.status import positive_definite

_SYMMETRIC = 1e-9  # of the greatest entry


def problem_from(
    mechanism: Mechanism,
    q: Any,
    K: Any,
    T: Any,
    *,
    priority: Any,
    weights: Any,
    min_force: Any,
    max_force: Any,
    previous: Any,
    max_step: Any,
    kind: StiffnessKind = ISOBARIC,
) -> tuple[MechanismProblem, tuple[int, ...]]:
    """Return the checked problem and the common shape of its targets. Raises `InvalidInput`."""
    n, m = mechanism.n, mechanism.m
    posture, torque = mechanism.posture(q), _torque(mechanism, T)
    now = None if previous is None else mechanism.pressures("previous", previous)
    step = None if max_step is None else checks.positive_pressure("max_step", max_step)
    if step is not None and now is None:
        raise InvalidInput("max_step limits how far the pressures move from previous; give previous, too")
    others = [x.shape[:-1] for x in (posture, torque, now) if x is not None]
    stiffness, own_only = _stiffness(mechanism, K, _common(others, n, m))
    shape = _common([*others, stiffness.shape[:-2], () if step is None else step.shape], n, m)
    if priority not in PRIORITIES:
        raise InvalidInput(f"priority = {priority!r} is unknown; choose one of {', '.join(PRIORITIES)}")
    stacked = mechanism.stacked(
        np.broadcast_to(torque, (*shape, n)), np.broadcast_to(stiffness, (*shape, n, n))
    ).reshape(-1, n + n * (n + 1) // 2)
    slew = None
    if now is not None:
        now = np.broadcast_to(now, (*shape, m)).reshape(-1, m)
        slew = tuple(now.T) if step is not None else None
        step = None if step is None else np.broadcast_to(step, shape).ravel()
    forces = zip(mechanism.each("min_force", min_force), mechanism.each("max_force", max_force), strict=True)
    limits = tuple(Limits(low, high, None, slew, step) for low, high in forces)
    for name, limit in zip(mechanism.muscle_names, limits, strict=True):
        if limit.max_force is not None and limit.max_force <= (limit.min_force or 0.0):
            raise InvalidInput(
                f"max_force = {limit.max_force:g} N of {name} has to exceed min_force = {limit.min_force or 0.0:g} N"
            )
    asked = posture[None] if posture.ndim == 1 else np.broadcast_to(posture, (*shape, n)).reshape(-1, n)
    reference = np.zeros((1, m)) if now is None else now
    row_weights = _weights(mechanism, priority, weights, own_only)
    return MechanismProblem(mechanism, np.array(asked), stacked, row_weights, priority, limits, reference, kind), shape


def _common(shapes: list[tuple[int, ...]], n: int, m: int) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        listed = ", ".join(map(str, shapes))
        raise InvalidInput(
            f"leading shapes do not broadcast: {listed}; expected q (…, {n}), T (…, {n}), K (…, {n}, {n}) and "
            f"pressures (…, {m}) of a mechanism with n = {n} joints and m = {m} muscles"
        ) from None


def _torque(mechanism: Mechanism, T: Any) -> Array:
    array = checks.real("T", T, "N·m")
    if array.ndim == 0:
        return np.full(mechanism.n, float(array))
    return mechanism.sized("T", array, mechanism.n, "torques [N·m]")


def _stiffness(mechanism: Mechanism, K: Any, others: tuple[int, ...]) -> tuple[Array, bool]:
    """Return the stiffness (…, n, n), and whether only its diagonal is asked for."""
    n, array = mechanism.n, checks.real("K", K, "N·m/rad")
    if array.ndim >= 2 and array.shape[-2:] == (n, n):
        if array.ndim == 2 and n > 1 and others == (n,):
            raise InvalidInput(
                f"K of the shape {array.shape} is one matrix or the diagonals of {n} targets; write the matrix as "
                f"(1, {n}, {n}), and {n} diagonals as {n} calls"
            )
        return _positive_definite(array), False
    if array.ndim == 0:
        array = np.full(n, float(array))
    if array.shape[-1] != n:
        raise InvalidInput(
            f"K has the shape {array.shape}; expected matrices (…, {n}, {n}), diagonals (…, {n}) or a number, of a "
            f"mechanism with n = {n} joints and m = {mechanism.m} muscles"
        )
    checks.stiffness("K", array)
    return array[..., None] * np.eye(n), n > 1


def _positive_definite(K: Array) -> Array:
    """Return stiffness matrices; refuse what is not symmetric, or does not hold itself."""
    gap = np.abs(K - K.swapaxes(-1, -2)).max(axis=(-1, -2))
    crooked = gap > _SYMMETRIC * np.abs(K).max(axis=(-1, -2))
    if crooked.any():
        raise InvalidInput(
            f"K{_place(crooked)} is not symmetric: a stiffness is, K_ij = K_ji (they differ by "
            f"{gap[crooked].max():.3g} N·m/rad)"
        )
    if positive_definite(K.reshape(-1, *K.shape[-2:])).all():  # in a quarter of the eigenvalues' time
        return K
    least = np.linalg.eigvalsh(K)[..., 0]
    if (weak := least <= 0).any():
        raise InvalidInput(
            f"K{_place(weak)} has the eigenvalue {least[weak].min():.4g} N·m/rad; a stiffness to ask for "
            "has to be positive definite: such a posture does not hold itself"
        )
    return K


def _place(wrong: Any) -> str:
    return f"[{', '.join(str(int(i[0])) for i in np.nonzero(wrong))}]" if np.ndim(wrong) else ""


def _weights(mechanism: Mechanism, priority: str, weights: Any, own_only: bool) -> Array:
    """Return the weights (d,) of the squared errors in y."""
    n = mechanism.n
    if weights is None:
        if priority == "weighted":
            raise InvalidInput("priority='weighted' needs weights = (w_T, w_K)")
        weights = 1.0, 1.0
    try:
        w_T, w_K = weights
    except (TypeError, ValueError):
        raise InvalidInput(f"weights = {checks.brief(weights)} have to be two, (w_T, w_K)") from None
    torque = checks.real("weights[0]", w_T, "cost/[N·m]²")
    stiffness = checks.real("weights[1]", w_K, "cost/[N·m/rad]²")
    if torque.shape not in ((), (n,)) or stiffness.shape not in ((), (n, n)):
        raise InvalidInput(f"weights have to be numbers, or w_T ({n},) and w_K ({n}, {n}) for n = {n} joints")
    if (torque < 0).any() or (stiffness < 0).any() or not torque.any() or not stiffness.any():
        raise InvalidInput("weights must not be negative, and not all of w_T or of w_K zero")
    matrix = np.broadcast_to(stiffness, (n, n)) * (np.eye(n) if own_only else 1.0)
    if not np.allclose(matrix, matrix.T):
        raise InvalidInput("weights[1] has to be symmetric, as K is")
    doubled = matrix * (2.0 - np.eye(n))  # beside the diagonal an entry stands twice in the sum
    return mechanism.stacked(np.broadcast_to(torque, (n,)), doubled)


__all__ = ["problem_from"]
