"""Memory of the rest mode of n joints and m muscles: the arrays, and the places of numbers in them."""

from typing import Annotated, NamedTuple

from allocator.calculus import Array

QUARTERS, HALF = 4, 2
SWINGS = QUARTERS + HALF  # a load that displaces a joint is in QUARTERS of them

(
    QUARTER_LENGTH,  # of the longest free period [samples]
    RINGS, RESTS,  # whether a joint rings, whether the commands rest
    SIDE,  # edge of the dead band
    SINCE,  # quarters since the last correction
    SAMPLES,  # of constant preview
    COUNTED, SWUNG,  # quarters, and the number of those over which e has swung to both sides
    IN_SUM,  # samples in the current quarter
) = range(9)  # fmt: skip
(
    THETA,  # the constant reference [rad]
    ASKED, ERROR,  # torque of the last correction, for this joint alone [N·m], and its mean e [rad]
    FREE,  # the angle by which it would turn a joint without friction [rad]
    USUAL,  # recent error of the prediction of θ outside a rest, over about a period [rad]
    SUM, LEAST, GREATEST,  # of e in the current quarter
    TORQUE,  # room for the remainder of a torque to be shared [N·m]
) = range(9)  # fmt: skip
(
    HELD,  # held pressure [Pa]
    BEGAN,  # pressure when the rest began, or as it was corrected [Pa]
    FILLED,  # its sum in the current quarter
    CHANGE,  # room for a correction [Pa]
) = range(4)
E, LOW, HIGH = range(3)  # of a joint in a quarter: mean, least and greatest e


class Memory(NamedTuple):
    """Memory of the rest mode, of n joints and m muscles."""

    shared: Annotated[Array, 9]
    joint: Annotated[Array, "n", 9]
    muscle: Annotated[Array, "m", 4]
    turned: Annotated[Array, QUARTERS, "n", 3]
    filled: Annotated[Array, QUARTERS, "m"]  # mean pressures
    stiffness: Annotated[Array, "n * n"]  # entries of the constant reference K [N·m/rad], the first k k in use


class Rules(NamedTuple):
    """Known numbers of a machine and its regulators."""

    inertia: float  # [kg·m²] the greatest of a joint
    dt: float  # [s]
    settling: float  # [samples] until a correction has acted
    dwell: float  # [samples]
    shortest: float  # quarter [samples]
    longest: float
    dead_band: float  # [Pa]
    highest: float  # pressure [Pa]
    jolt: float  # [rad] least error of a prediction that counts as a push
