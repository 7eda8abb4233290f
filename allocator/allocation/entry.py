"""`allocate`: from torque and stiffness targets to pressures, of a joint or a mechanism."""

from typing import overload

from numpy.typing import ArrayLike

from allocator import checks
from allocator.allocation.arguments import Asked, Method, Name
from allocator.allocation.box import pivoting, ready
from allocator.allocation.box import solve as box
from allocator.allocation.box.result import BoxAllocation
from allocator.allocation.result import Allocation
from allocator.allocation.status import Priority
from allocator.allocation.two_muscles import solve as two_muscles
from allocator.allocation.two_muscles.kernels import calls
from allocator.allocation.two_muscles.result import PairAllocation
from allocator.calculus import Value
from allocator.checks import float_or_nan
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint, joint_or_report, report_joint
from allocator.joint.gas import HELD, ISOBARIC, Stiffness
from allocator.joint.limits import TAUT, Limits
from allocator.mechanism.mechanism import Mechanism
from allocator.presentation.progress import waiting


@overload
def allocate(
    theta: ArrayLike,
    K: ArrayLike,
    T: ArrayLike = ...,
    *,
    joint: AntagonistJoint | None = ...,
    limits: Limits = ...,
    stiffness: Stiffness = ...,
    priority: Priority = ...,
    weights: tuple[ArrayLike, ArrayLike] | None = ...,
    pull: tuple[float, ArrayLike] | None = ...,
    along: int | None = ...,
    direction: Value = ...,
    method: Name | Method = ...,
) -> PairAllocation: ...


@overload
def allocate(
    theta: ArrayLike,
    K: ArrayLike,
    T: ArrayLike = ...,
    *,
    joint: Mechanism,
    limits: Limits = ...,
    stiffness: Stiffness = ...,
    priority: Priority = ...,
    weights: tuple[ArrayLike, ArrayLike] | None = ...,
    pull: tuple[float, ArrayLike] | None = ...,
    along: int | None = ...,
    direction: Value = ...,
    method: Name | Method = ...,
) -> BoxAllocation: ...


def allocate(
    theta: ArrayLike,
    K: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    joint: AntagonistJoint | Mechanism | None = None,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
    priority: Priority = "torque",
    weights: tuple[ArrayLike, ArrayLike] | None = None,
    pull: tuple[float, ArrayLike] | None = None,
    along: int | None = None,
    direction: Value = 0.0,
    method: Name | Method = "exact",
) -> Allocation:
    """Return the pressures that give stiffness `K` and torque `T` at the posture `theta`, or the closest feasible ones.

    Solves problem [A] of `allocator.allocation.two_muscles.problem` for an `AntagonistJoint`, problem [M] of
    `allocator.allocation.box.problem` for a `Mechanism` of n joints and m muscles. Targets broadcast like a ufunc;
    those of a mechanism in leading axes.

    Parameters
    ----------
    theta, K, T
        Joint angle [rad], stiffness [N·m/rad] and torque [N·m]; scalars or arrays. An angle beyond the limits is moved
        to the nearest limit, which the answer names. Of a mechanism postures and torques are (…, n), or one torque for
        all joints; stiffnesses are symmetric positive definite matrices (…, n, n), or only their diagonals (…, n), or
        one number for the whole diagonal: the other entries are then free.
    joint
        An `AntagonistJoint` or a `Mechanism`; by default the report's joint (two Tondu2021 DMSP-20-400N on a 2 cm
        pulley, 0–5 bar, ±125°).
    limits
        Limits on forces and pressures beyond supply and joint range. By default cables are kept taut. Of a mechanism
        `previous` without `max_step` is the reference: among equally good pressures the nearest to it are returned,
        instead of the nearest to 0.
    stiffness
        Kind of the stiffness `K`: by default isobaric; `Stiffness("shut")` with trapped gas, `Stiffness(frequency=2.0,
        lag=0.1)` against motion at a frequency, `Stiffness(amplitude=2*DEG)` against pushes by ±2° with the joint's
        hysteresis (of a mechanism with a `loop` for each joint), `Stiffness(tolerance=0.5)` within a tolerance; for
        free valves see `Allocation.valves`. Of an endpoint K is K_x [N/m], matrices (…, dim, dim), diagonals or a
        number, and T is added to Jᵀ·force; the nearest K_x has the least ‖K_x*^(-1/2) (K_x - K_x*) K_x*^(-1/2)‖_F. With
        n > dim the joints in the null space of the hand are free: the answer is a local optimum, found by relinearising
        K_x.
    priority
        Target that is met first if both cannot be: "torque", "stiffness", or "weighted" by `weights`.
    weights
        (w_T, w_K) in [cost]/[N·m]² and [cost]/[N·m/rad]², for priority "weighted". Of a mechanism also w_T (n,) and
        w_K (n, n) for each entry, 0 for free ones; the sum over K has all n² entries.
    pull
        (ρ, P_ref) in [cost]/[Pa]² and [Pa]: a pull of the pressures towards a reference (P1, P2), or (…, m); of a
        mechanism for priority "weighted".
    along
        The axis of the targets along which time runs, for "exact". Of a joint: where several pairs of pressures give
        the same torque and stiffness (on some levers), the pairs of the whole trajectory are chosen together, with the
        least sum of squared steps. Of a mechanism each solution starts from the limits that bind at the previous
        target.
    direction
        Direction of motion: +1 θ rises, -1 θ falls, 0 it rests (default). The muscles of a joint with `friction` then
        also overcome the friction, so that the link receives `T`; the answer's torques are the muscles'.
    method
        A name, or a `Method` with the options of a solver. Of a mechanism "exact" is block principal pivoting, or for
        curved muscles a search within `Method.gap`; "qp" one QP a level through qpsolvers, slow and readable.

    Raises
    ------
    InvalidInput
        For an invalid argument: NaN, K ≤ 0 or not positive definite, degrees for radians, bar for Pa, shapes that do
        not fit, contradictory limits; for a pull without a closed form of "exact"; for invalid valves, frequencies or
        lags, and for gas in a muscle of unknown volume (`Muscle.rest_volume`); for a force law that gives no number at
        the posture, or a force that falls again with the pressure; and if an endpoint's Jacobian is singular.
    MissingBackend
        For an unknown method or solver; the message lists the available ones.
    """
    joint = report_joint() if joint is None else joint
    if (
        isinstance(method, str)  # and no array
        and method == "exact"
        and weights is pull is along is None  # type: ignore[comparison-overlap]  # all None
        and type(limits) is Limits
        and _ordinary(joint, direction, stiffness)
    ):
        found: Allocation | None = None
        if isinstance(joint, AntagonistJoint):
            kind = HELD if stiffness is ISOBARIC else stiffness.kind().of_gas(joint.gas, joint.affine)
            found = calls.answer(joint, theta, K, T, priority, limits, kind)
        elif isinstance(joint, Mechanism) and stiffness is ISOBARIC:
            found = ready.answered(joint, theta, K, T, priority, limits)
        if found is not None:
            return found
    asked = Asked(theta, K, T, limits, stiffness, priority, weights, pull, along, direction, Method.of(method))
    if isinstance(joint, AntagonistJoint):
        return two_muscles.allocated(joint, asked)
    if isinstance(joint, Mechanism):
        return box.allocated(joint, asked)
    getattr(joint, "sides", None)  # type: ignore[unreachable]  # a joint without a force scale raises its own sentence
    raise InvalidInput(f"joint = {checks.brief(joint)} has to be an AntagonistJoint or a Mechanism")


def _ordinary(joint: object, direction: object, stiffness: Stiffness) -> bool:
    """Return whether there is no friction, and neither a tolerance, an endpoint nor a force is given."""
    if stiffness is not ISOBARIC and not (
        type(stiffness) is Stiffness
        and float_or_nan(stiffness.tolerance) == float_or_nan(stiffness.force) == 0
        and stiffness.endpoint is None
    ):
        return False
    if type(direction) is float and direction == 0:
        return True
    s = float_or_nan(direction)
    return s == 0 or (isinstance(joint, AntagonistJoint) and joint.friction == 0 and abs(s) <= 1)


def warm_up(
    *,
    joint: AntagonistJoint | Mechanism | None = None,
    priority: Priority = "torque",
    min_force: float | None = 0.0,
    max_force: float | None = None,
    slew: bool = False,
    gas: bool = False,
) -> bool:
    """Compile the code that `allocate` needs for these options now, so that no later call waits for it.

    Without it `allocate` compiles only for an array of 300 000 targets or more, of a mechanism 5 000.

    Parameters
    ----------
    joint
        An `AntagonistJoint`, by default the report's, or a `Mechanism`, for which the other options do not matter.
        Up to 2048 targets a call for this object are then solved in compiled code if its routes have formulas (not
        tables).
        Compiling takes some seconds the first time after installation (half a minute for muscles that are not affine
        and for mechanisms), and half a second in a new process, most of it the import of numba.
    priority, min_force, max_force
        As in `allocate` and `Limits`.
    slew
        Whether calls will have `previous` and `max_step`.
    gas
        Whether calls will have `valves` or a `frequency`, on muscles that are not affine.

    Returns
    -------
    bool
        False if nothing can be compiled: there is no kernel for weighted targets of affine muscles, or numba is missing
        or finds no cache directory. `allocate` then works more slowly.

    Raises
    ------
    InvalidInput
        For an unknown priority or an invalid limit.
    """
    joint = joint_or_report(joint) if not isinstance(joint, Mechanism) else joint
    if isinstance(joint, Mechanism):
        with waiting("compiling the allocation"):
            return pivoting.warm_up() and (ready.warm_up(joint) or not joint.affine)
    return calls.warm_up(joint, priority, Limits(min_force, max_force), slew, gas)
