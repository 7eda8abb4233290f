"""Checks that turn the arguments of `allocate` about a mechanism into a `BoxProblem`."""

from typing import NamedTuple, Self

import numpy as np

from allocator import checks
from allocator.allocation.arguments import checked_priority, pulled
from allocator.allocation.box.problem import BoxProblem, positive_definite
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.joint.gas import ISOBARIC, Stiffness, StiffnessKind, checked_stiffness
from allocator.joint.limits import TAUT, Limits, checked_limits
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.endpoint.targets import EndpointTargets
from allocator.mechanism.mechanism import Mechanism

_SYMMETRIC = 1e-9  # of the greatest entry


def problem_from(
    mechanism: Mechanism,
    theta: object,
    K: object,
    T: object,
    *,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
    priority: object = "torque",
    weights: object = None,
    pull: object = None,
) -> tuple[BoxProblem, tuple[int, ...]]:
    """Return the checked problem and the common shape of its targets. Raises `InvalidInput`."""
    n, m = mechanism.n, mechanism.m
    limits = checked_limits(limits)
    kind, endpoint, force = _meant(mechanism, stiffness)
    asked_of = _AskedOf.of(mechanism, endpoint)
    exerted = np.zeros(0) if endpoint is None else endpoint.force(force)
    posture, torque = mechanism.posture(theta, "theta"), _torque(mechanism, T)
    now, step = _slew(mechanism, limits)
    weight, toward = _pull(mechanism, priority, pull)
    others = [x.shape[:-1] for x in (posture, torque, now, exerted, toward) if x is not None]
    K, own_only = _stiffness(asked_of, K, _common(others, n, m))
    shape = _common([*others, K.shape[:-2], () if step is None else step.shape], n, m)
    chosen = checked_priority(priority)
    asked, hand = _flat(posture, shape, 1), None
    torque = _rows(torque, shape)
    if endpoint is not None:
        exerted, K = _flat(exerted, shape, 1), _flat(K, shape, 2)
        hand = EndpointTargets.at(endpoint, mechanism.within(asked), exerted, K)
        torque, K = torque + hand.torque, np.eye(endpoint.dim)
    y, slew = np.concatenate([torque, _rows(K[(..., *np.triu_indices(asked_of.size))], shape)], axis=1), None
    if now is not None:
        now = _rows(now, shape)
        slew = tuple(now.T) if step is not None else None
        step = None if step is None else np.broadcast_to(step, shape).ravel()
    each = tuple(Limits(*pair, None, slew, step) for pair in mechanism.force_limits(limits))
    reference = np.zeros((1, m)) if now is None else now
    reference = reference if toward is None else _flat(toward, shape, 1)
    given = mechanism, asked, y, _weights(n, asked_of, chosen, weights, own_only), chosen, each, reference, kind, hand
    return BoxProblem(*given, kind.added(n), weight), shape


def _slew(mechanism: Mechanism, limits: Limits) -> tuple[Array | None, Array | None]:
    """Return the present pressures (…, m) and the greatest step (…) from them [Pa]; None where not given."""
    now = None if limits.previous is None else mechanism.pressures("previous", limits.previous)
    if limits.max_step is None:
        return now, None
    step = checks.positive_pressure("max_step", limits.max_step)
    if now is None:
        raise InvalidInput("max_step limits the change of the pressures from previous; give previous as well")
    return now, step


def _meant(mechanism: Mechanism, stiffness: object) -> tuple[StiffnessKind, Endpoint | None, object]:
    """Return (the kind of stiffness, the endpoint or None, the force there). Raises `InvalidInput`."""
    stiffness = checked_stiffness(stiffness)
    if stiffness.endpoint is None and np.any(stiffness.force):
        raise InvalidInput("force is that of an endpoint; give endpoint, too")
    if checks.not_negative("tolerance", stiffness.tolerance, "N·m/rad"):
        raise InvalidInput("a stiffness tolerance is for an AntagonistJoint, whose stiffness is one number")
    kind = stiffness.kind(mechanism.muscle_names).of_gas(mechanism.gas, mechanism.affine)
    if kind.amplitude is not None:
        mechanism.check_affine("the stiffness felt by a push")
    if kind.shares is None:
        raise InvalidInput("valves = 'free' are for an AntagonistJoint; of a mechanism choose 'open' or 'shut'")
    return kind, stiffness.endpoint, stiffness.force


class _AskedOf(NamedTuple):
    """Owner of the requested stiffness (…, size, size): the joints or an endpoint."""

    size: int
    unit: str
    text: str

    @classmethod
    def of(cls, mechanism: Mechanism, endpoint: object) -> Self:
        """Return that of `endpoint`, or of the mechanism without one. Raises `InvalidInput` if they do not fit."""
        if endpoint is None:
            text = f"a mechanism with n = {mechanism.n} joints and m = {mechanism.m} muscles"
            return cls(mechanism.n, "N·m/rad", text)
        if not isinstance(endpoint, Endpoint):
            raise InvalidInput(
                f"endpoint is a {type(endpoint).__name__}; expected an Endpoint, such as Endpoint.planar"
            )
        if endpoint.n != mechanism.n:
            raise InvalidInput(f"the endpoint has n = {endpoint.n} joints, the mechanism n = {mechanism.n}")
        mechanism.check_affine("the stiffness of an endpoint")
        return cls(endpoint.dim, "N/m", endpoint.text)


def _rows(array: Array, shape: tuple[int, ...]) -> Array:
    """Return rows (N, k) of an array (…, k) in the common shape."""
    return np.broadcast_to(array, (*shape, array.shape[-1])).reshape(-1, array.shape[-1])


def _flat(array: Array, shape: tuple[int, ...], axes: int) -> Array:
    """Return rows (N, …) of an array (…, …) of items with `axes` axes; one row if it is a single item."""
    if array.ndim == axes:
        return np.array(array[None])
    own = array.shape[-axes:]
    return np.array(np.broadcast_to(array, (*shape, *own)).reshape(-1, *own))


def _common(shapes: list[tuple[int, ...]], n: int, m: int) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        listed = ", ".join(map(str, shapes))
        raise InvalidInput(
            f"leading shapes do not broadcast: {listed}; expected theta (…, {n}), T (…, {n}), K (…, {n}, {n}) and "
            f"pressures (…, {m}) of a mechanism with n = {n} joints and m = {m} muscles"
        ) from None


def _torque(mechanism: Mechanism, T: object) -> Array:
    array = checks.real("T", T, "N·m")
    if array.ndim == 0:
        return np.full(mechanism.n, float(array))
    return mechanism.sized("T", array, mechanism.n, "torques [N·m]")


def _stiffness(of: _AskedOf, K: object, others: tuple[int, ...]) -> tuple[Array, bool]:
    """Return the stiffness (…, size, size), and whether only its diagonal is given."""
    size, array = of.size, checks.real("K", K, of.unit)
    if array.ndim >= 2 and array.shape[-2:] == (size, size):
        if array.ndim == 2 and size > 1 and others == (size,):
            raise InvalidInput(
                f"K of the shape {array.shape} is one matrix or the diagonals of {size} targets; write the matrix as "
                f"(1, {size}, {size}), and {size} diagonals as {size} calls"
            )
        return _positive_definite(array, of.unit), False
    if array.ndim == 0:
        array = np.full(size, float(array))
    if array.shape[-1] != size:
        raise InvalidInput(
            f"K has the shape {array.shape}; expected matrices (…, {size}, {size}), diagonals (…, {size}) or a number "
            f"[{of.unit}], of {of.text}"
        )
    if (wrong := array <= 0).any():
        raise InvalidInput(f"K{checks.at(array, wrong)} {of.unit} has to be positive")
    return array[..., None] * np.eye(size), size > 1


def _positive_definite(K: Array, unit: str) -> Array:
    """Return stiffness matrices. Raises `InvalidInput` unless they are symmetric and positive definite."""
    gap = np.abs(K - K.swapaxes(-1, -2)).max(axis=(-1, -2))
    crooked = gap > _SYMMETRIC * np.abs(K).max(axis=(-1, -2))
    if crooked.any():
        raise InvalidInput(
            f"K{_place(crooked)} is not symmetric: a stiffness is, K_ij = K_ji (they differ by "
            f"{gap[crooked].max():.3g} {unit})"
        )
    if positive_definite(K.reshape(-1, *K.shape[-2:])).all():  # in a quarter of the eigenvalues' time
        return K
    least = np.linalg.eigvalsh(K)[..., 0]
    if (weak := least <= 0).any():
        raise InvalidInput(
            f"K{_place(weak)} has the eigenvalue {least[weak].min():.4g} {unit}; a stiffness to ask for "
            "has to be positive definite: such a posture does not hold itself"
        )
    return K


def _place(wrong: Mask) -> str:
    return f"[{', '.join(str(int(i[0])) for i in np.nonzero(wrong))}]" if np.ndim(wrong) else ""


def _weights(n: int, of: _AskedOf, priority: str, weights: object, own_only: bool) -> Array:
    """Return the weights (d,) of the squared errors in y."""
    size = of.size
    if weights is None:
        if priority == "weighted":
            raise InvalidInput("priority='weighted' needs weights = (w_T, w_K)")
        weights = 1.0, 1.0
    w_T, w_K = checks.pair("weights", weights, "have to be two, (w_T, w_K)")
    torque = checks.real("weights[0]", w_T, "cost/[N·m]²")
    stiffness = checks.real("weights[1]", w_K, "cost/[N·m/rad]²")
    if torque.shape not in ((), (n,)) or stiffness.shape not in ((), (size, size)):
        raise InvalidInput(f"weights have to be numbers, or w_T ({n},) and w_K ({size}, {size}) for n = {n} joints")
    if (torque < 0).any() or (stiffness < 0).any() or not torque.any() or not stiffness.any():
        raise InvalidInput("weights must not be negative, and not all of w_T or of w_K zero")
    matrix = np.broadcast_to(stiffness, (size, size)) * (np.eye(size) if own_only else 1.0)
    if not np.allclose(matrix, matrix.T):
        raise InvalidInput("weights[1] has to be symmetric, as K is")
    doubled = matrix * (2.0 - np.eye(size))  # off-diagonal entries occur twice in the sum
    return np.concatenate([np.broadcast_to(torque, (n,)), doubled[np.triu_indices(size)]])


def _pull(mechanism: Mechanism, priority: object, pull: object) -> tuple[float, Array | None]:
    """Return the weight of ‖(P - P_ref)/unit‖² and P_ref (…, m); (0, None) without a pull."""
    if pull is None:
        return 0.0, None
    rho, reference = pulled(pull)
    if priority != "weighted":
        raise InvalidInput("of a mechanism a pull belongs to priority='weighted'")
    return rho * mechanism.pressure_limits[1] ** 2, mechanism.pressures("pull[1]", reference)
