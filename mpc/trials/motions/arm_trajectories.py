"""References for arms: swings of all joints, reaches, a posture, a drawing; each with a stiffness matrix."""

from collections.abc import Callable, Mapping

import numpy as np

from allocator import allocate, checks
from allocator.calculus import Array
from allocator.errors import InvalidInput, MissingBackend
from allocator.mechanism import Pulleys
from allocator.mechanism.bodies import Bodies
from allocator.units import DEG
from mpc.model.arm.model import Arm
from mpc.trials.motions.reference import Reference, min_jerk

_STIFFNESS = {2: [[12.0, 4.6], [4.6, 9.5]]}
_EACH = 6.0  # [N·m/rad] of every joint of other arms
_SWING = 23.0, 17.0, 15.0, 12.0  # [°]
_K_SWING = 1.5  # [N·m/rad] of K11
_NEAR = 1 / 3  # [-] of the greatest entry, greatest error of a usual stiffness, such as of biarticular muscles
_MOST = 0.6  # [-] of a joint's range, greatest swing
_SHARES = 1.0, 0.7, 0.5, 0.35, 0.25  # [-] of a swing; the first one that the arm can hold is used
_STEP, _ROUNDS = 1e-3, 3  # difference over the supply's span, and steps of Newton's method, exact after one if affine
_HELD = 0.1  # [-] of the least stiffness in the middle, required elsewhere


def circle(arm: Arm, frequency: float = 0.5, turns: float = 4.0, size: float = 1.0) -> Reference:
    """Return swings of all joints, each a quarter of a period later, by ±23°, ±17°, … times `size`, while K11 swings.

    The joints swing about the middles of their ranges, and less if the arm would not hold itself. K is
    [[12 ± 1.5, 4.6], [4.6, 9.5]] for two joints on pulleys with a biarticular pair, and diag(6 ± 1.5, 6, …) for others
    on pulleys, if their muscles come near it, and otherwise the stiffness at pressures half-way from slack to the
    greatest ones, ± 10 %.

    Raises `InvalidInput`.
    """
    frequency = checks.positive("frequency", frequency, "Hz")
    swings, w = usual_swings(arm, checks.positive("size", size, "-")), 2 * np.pi * frequency
    middle, K_of, of_numbers = middle_of(arm), usual_stiffness(arm), _usual_number(arm) is not None

    def at(t: Array) -> tuple[Array, Array]:
        phase = w * t[:, None] + np.arange(arm.n) * np.pi / 2
        q = middle + swings * np.sin(phase)
        K = K_of(q)
        if of_numbers:
            K[:, 0, 0] += _K_SWING * np.sin(w * t)
        else:
            K *= 1 + 0.1 * np.sin(w * t)[:, None, None]
        return q, tracked_stiffness(arm, q, K)

    return Reference.of("circle", checks.positive("turns", turns, "-") / frequency, at)


def reach(arm: Arm, seconds: float = 1.0, rest: float = 1.5) -> Reference:
    """Return minimum-jerk movements from one side to the other and back, with rests of `rest` [s] at the ends.

    Raises `InvalidInput`.
    """
    seconds, rest = checks.positive("seconds", seconds, "s"), checks.positive("rest", rest, "s")
    ends, middle = _swings(arm, np.resize([20.0, -15.0], arm.n) * DEG), middle_of(arm)
    K_of, period = usual_stiffness(arm), seconds + rest

    def at(t: Array) -> tuple[Array, Array]:
        whole = np.minimum(t // period, 2)
        done = min_jerk((t - whole * period - rest) / seconds)
        done = np.where(whole % 2 == 0, done, 1 - done)
        done = np.where(whole >= 2, 0.0, done)
        q = middle + (2 * done[:, None] - 1) * ends
        return q, tracked_stiffness(arm, q, K_of(q))

    return Reference.of("reach", 2 * period + rest, at)


def hold(arm: Arm, seconds: float = 4.0) -> Reference:
    """Return a constant posture. Raises `InvalidInput`."""
    posture = middle_of(arm) + _swings(arm, np.resize([20.0, -15.0], arm.n) * DEG)
    K = tracked_stiffness(arm, posture[None], usual_stiffness(arm)(posture[None]))[0]
    return Reference.of("hold", seconds, lambda t: (np.tile(posture, (t.size, 1)), np.tile(K, (t.size, 1, 1))))


def draw(arm: Arm, seconds: float = 4.0, turns: float = 2.0) -> Reference:
    """Return a figure of eight, 12 cm high, drawn by the hand of an arm with two links while its stiffness turns.

    The joints' K = [[12 + 2 sin φ, 4.6 + 0.8 cos φ], [4.6 + 0.8 cos φ, 9.5 - 1.5 sin φ]] turns once per figure; that of
    the hand is K_x with K = JᵀK_x J (M4). Raises `InvalidInput` for an arm with other than two joints.
    """
    if arm.n != 2 or not isinstance(arm.bodies, Bodies) or not isinstance(arm.mechanism.routes, Pulleys):
        raise InvalidInput(
            f"draw is for arm26, with n = 2 joints in the plane, whose hand determines the angles; n = {arm.n}"
        )
    seconds = checks.positive("seconds", seconds, "s")
    first, second = arm.bodies.length
    middle = 0.91 * (first + second)

    def at(t: Array) -> tuple[Array, Array]:
        phase = 2 * np.pi * t / seconds
        x, y = middle + 0.033 * middle * np.sin(2 * phase), 0.1 * middle * np.sin(phase)
        elbow = np.arccos(np.clip((x**2 + y**2 - first**2 - second**2) / (2 * first * second), -1.0, 1.0))
        shoulder = np.arctan2(y, x) - np.arctan2(second * np.sin(elbow), first + second * np.cos(elbow))
        q = np.stack([shoulder, elbow], axis=-1)
        K = usual_stiffness(arm)(q)
        K[:, 0, 0] += 2.0 * np.sin(phase)
        K[:, 1, 1] -= 1.5 * np.sin(phase)
        K[:, 0, 1] += 0.8 * np.cos(phase)
        K[:, 1, 0] += 0.8 * np.cos(phase)
        return q, tracked_stiffness(arm, q, K)

    return Reference.of("draw", checks.positive("turns", turns, "-") * seconds, at)


def tracked_stiffness(arm: Arm, q: Array, K: Array) -> Array:
    """Return the tracked stiffness for the joints' stiffness `K` (k, n, n) at the postures `q` (k, n).

    Raises `InvalidInput` if the hand's stiffness is tracked and infinite.
    """
    if arm.endpoint is not None:
        try:
            arm.endpoint.check_rank(arm.endpoint.at(q))
        except InvalidInput as error:
            raise InvalidInput(f"this reference cannot be followed with the stiffness of the hand: {error}") from None
    return arm.seen(q, K)


def usual_stiffness(arm: Arm) -> Callable[[Array], Array]:
    """Return the joints' stiffness (k, n, n) [N·m/rad] over postures (k, n).

    On pulleys it is the same everywhere, if the muscles come near it; otherwise it is that of pressures about half-way
    from slack to the greatest ones which hold the arm against gravity.
    """
    if (K := _usual_number(arm)) is not None:
        return lambda q: np.tile(K, (len(q), 1, 1))
    return lambda q: arm.mechanism.stiffness(q, _balanced(arm, q))


def _balanced(arm: Arm, q: Array) -> Array:
    """Return the pressures (k, m) [Pa] nearest to those half-way from slack to the greatest ones which hold the arm
    against gravity, by Newton's method. Those beyond the supply are clipped.
    """
    mechanism, gravity = arm.mechanism, arm.bodies.gravity_torque(q)
    least, most = mechanism.pressure_box(q)
    P = np.where(least < most, (least + most) / 2, np.mean(mechanism.pressure_limits))
    step = _STEP * mechanism.pressure_span
    for _ in range(_ROUNDS):
        T = mechanism.torque(q, P)
        slopes = [(mechanism.torque(q, P + step * muscle) - T) / step for muscle in np.eye(mechanism.m)]
        P = P - np.einsum("kmn,kn->km", np.linalg.pinv(np.stack(slopes, axis=-1)), T - gravity)
    return np.clip(P, *mechanism.pressure_limits)


def _usual_number(arm: Arm) -> Array | None:
    """Return a usual stiffness (n, n) [N·m/rad]; None off pulleys, and if the muscles do not come near its swing."""
    if not isinstance(arm.mechanism.routes, Pulleys):
        return None
    crossing = arm.mechanism.arms(np.zeros(arm.n))
    coupled = arm.n == 2 and bool((np.abs(crossing) > 0).all(axis=1).any())
    K = np.array(_STIFFNESS[2]) if coupled else _EACH * np.eye(arm.n)
    ends = np.stack([K, K])
    ends[:, 0, 0] += -_K_SWING, _K_SWING
    q = np.stack([middle_of(arm)] * 2)
    given = allocate(q, ends, arm.bodies.gravity_torque(q), joint=arm.mechanism).K
    return K if np.abs(given - ends).max() <= _NEAR * K.max() else None


def usual_swings(arm: Arm, size: float = 1.0) -> Array:
    """Return swings (n,) [rad] of ±23°, ±17°, … times `size`, or less if the arm would not hold itself."""
    return _swings(arm, size * np.resize(_SWING, arm.n) * DEG)


def middle_of(arm: Arm) -> Array:
    """Return the middle (n,) [rad] of the ranges of the joints."""
    low, high = arm.angle_limits
    return np.asarray((low + high) / 2)


def _swings(arm: Arm, wanted: Array) -> Array:
    """Return the feasible swings (n,) [rad] of the joints to both sides of the middle, at most `wanted`.

    Raises `InvalidInput` for an arm that does not hold itself in the middle of its ranges.
    """
    (low, high), middle, K_of = arm.angle_limits, middle_of(arm), usual_stiffness(arm)
    swings = np.clip(wanted, -_MOST * (high - low) / 2, _MOST * (high - low) / 2)
    least = np.linalg.eigvalsh(K_of(middle[None]))[0, 0]
    if not least > 0:
        arms = arm.mechanism.arms(middle)
        if idle := [name for name, own in zip(arm.mechanism.joint_names, arms.T, strict=True) if not own.any()]:
            raise InvalidInput(f"no muscle moves {', '.join(idle)}: the arm does not hold itself there")
        raise InvalidInput(
            "the arm does not hold itself in the middle of its ranges at pressures half-way from slack to the greatest "
            f"ones: an eigenvalue of its stiffness is {least:.3g} N·m/rad; its muscles' arms grow too fast as they "
            "shorten"
        )
    away = np.random.default_rng(0).uniform(-1.0, 1.0, (256, arm.n))
    away[::2] /= np.abs(away[::2]).max(axis=1, keepdims=True)  # on the sides of the box
    for share in _SHARES:
        held = np.linalg.eigvalsh(K_of(middle + share * swings * away))[:, 0]
        if held.min() > _HELD * least:
            break
    return np.asarray(share * swings)


REFERENCES: Mapping[str, Callable[[Arm], Reference]] = {"circle": circle, "reach": reach, "hold": hold, "draw": draw}
"""References of the command line, by name."""


def reference(name: str, arm: Arm) -> Reference:
    """Return the reference of this name for `arm`. Raises `MissingBackend` for another name."""
    if name not in REFERENCES:
        raise MissingBackend("reference", name, list(REFERENCES))
    return REFERENCES[name](arm)
