"""Records of an arm that differ from those of a joint (`mpc.tracking.compiled.records`), for the same sizes."""

from typing import Annotated, NamedTuple

from allocator.calculus import Array
from mpc.tracking.compiled.records import Cost, Indices


class ArmPath(NamedTuple):
    """Motion and its derivatives, with pressures in Pa."""

    x: Annotated[Array, "N + 1", "x"]
    S: Annotated[Array, "N", "moving", "2 * n + 2 * m"]  # see `mpc.model.arm.compiled.motion`
    y: Annotated[Array, "N + 1", "y"]  # svec K, F
    slope: Annotated[Array, "N + 1", "n + m", "y"]  # of y by (q, P)
    kept: Annotated[Array, "m"]  # without gas, share of a pressure's error that remains after a sample


class ArmAlong(NamedTuple):
    """Path and its commands."""

    path: ArmPath
    u: Annotated[Array, "N", "m"]  # [bar]


class ArmBounds(NamedTuple):
    """`Bounds` of several joints."""

    low: float
    high: float
    step: float
    left: Annotated[Array, "n"]
    right: Annotated[Array, "n"]
    min_force: float


class ArmSetting(NamedTuple):
    """`Setting` with these bounds."""

    cost: Cost
    bounds: ArmBounds
    curvature: float
    exchanges: float
    accuracy: float
    slack: Annotated[Array, 4]
    starts: Indices


class ArmTargets(NamedTuple):
    """Targets of an arm's allocation, its answer, and working arrays for one of them."""

    A: Annotated[Array, "N + 1", "n + s", "m"]  # of torques and svec K by pressures in units of the supply
    b: Annotated[Array, "N + 1", "n + s"]
    hand_A: Annotated[Array, "N + 1", "n + s", "m"]  # the same with the stiffness of a hand
    hand_b: Annotated[Array, "N + 1", "n + s"]
    lo: Annotated[Array, "N + 1", "m"]
    hi: Annotated[Array, "N + 1", "m"]
    P: Annotated[Array, "N + 1", "m"]
    residual: Annotated[Array, "N + 1"]  # of optimality
    alpha: Annotated[Array, "n"]  # ω', and the values of `statics`
    T: Annotated[Array, "n"]
    y0: Annotated[Array, "n + s"]
    M: Annotated[Array, "(n + s) * m"]
    F0: Annotated[Array, "m"]
    gain: Annotated[Array, "m"]
    fall: Annotated[Array, 2, "m"]  # of the pressures by the motion, of two samples [Pa/s]


class ArmInverse(NamedTuple):
    """Numbers of an arm's `mpc.tracking.feedforward.InverseDynamics`."""

    alpha: Annotated[Array, "m"]
    lags: Annotated[Array, "m"]  # [s]
    most: Annotated[Array, "m"]  # pressures [Pa]
    low: float
    unit: float  # of the allocation's pressures [Pa]
    min_force: float  # [N]
    left: Annotated[Array, "n"]  # joint ranges [rad]
    right: Annotated[Array, "n"]
