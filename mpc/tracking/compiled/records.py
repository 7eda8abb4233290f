"""Records of the compiled functions. Commands count in bar, as decisions do.

Records with lengths lie in flat arrays, which Python passes in a fraction of the time: numba unpacks a record argument
field by field, which for dozens of arrays takes longer than the step itself.
"""

from collections.abc import Callable
from math import isqrt
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array, Mask
from allocator.units import BAR
from mpc.codegen.views import length_of, viewer
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, NU, STIFFNESSES
from mpc.tracking.limits import Limits

Indices: TypeAlias = NDArray[np.int64]
Signs: TypeAlias = NDArray[np.int8]  # the limit at which a change or its command is held, see `sizes`


class Cost(NamedTuple):
    """Weights of all entries of the rows of `mpc.tracking.cost`, and the terminal cost."""

    x: Annotated[Array, "x"]
    y: Annotated[Array, "y"]
    e: Annotated[Array, "m"]  # [cost]/[bar]²
    change: Annotated[Array, "m"]  # of e_k - e_{k-1} [cost]/[bar]²
    end: Annotated[Array, "xi", "xi"]  # of ξ = (x_N - x*_N, e_{N-1})


class Bounds(NamedTuple):
    """Limits of `mpc.tracking.limits.Limits`."""

    low: float  # supply [bar]
    high: float  # [bar]
    step: float  # [bar]
    left: float  # joint range [rad]
    right: float  # [rad]
    min_force: float  # [N]


def bounds_of(limits: Limits) -> Bounds:
    """Return the bounds of these `limits`."""
    low, high = limits.pressure
    return Bounds(low / BAR, high / BAR, limits.step / BAR, *limits.theta, limits.min_force)


class Setting(NamedTuple):
    """Constants of all steps."""

    cost: Cost
    bounds: Bounds
    curvature: float  # c [cost]/[bar]², lower bound of the Hessian's eigenvalues
    exchanges: float  # at most, per QP
    accuracy: float  # of an answer [bar]
    slack: Annotated[Array, 4]  # ρ, ρ₂, ρ_F, ρ_F₂
    starts: Indices  # samples at which the commands may leave ū


class Path(NamedTuple):
    """Motion of a joint and the linear model about it; that of an arm is in `mpc.tracking.compiled.arm.records`."""

    x: Annotated[Array, "N + 1", "x"]
    y: Annotated[Array, "N + 1", "y"]  # K, F1, F2
    A: Annotated[Array, "N", "x", "x"]
    B: Annotated[Array, "N", "x", "m"]  # per bar
    slope: Annotated[Array, "N + 1", "y", "x"]  # of y


class Reference(NamedTuple):
    """Arrays of `mpc.tracking.feedforward.FeedForward`; time is the first axis."""

    x: Annotated[Array, "N + 1", "x"]  # [Pa]
    y: Annotated[Array, "N + 1", "y"]
    u: Annotated[Array, "N", "m"]  # [Pa]


class Errors(NamedTuple):
    """Errors with a cost: the rows along a path minus their reference."""

    x: Annotated[Array, "N + 1", "x"]
    y: Annotated[Array, "N + 1", "y"]
    e: Annotated[Array, "N", "m"]  # of the commands [bar]
    change: Annotated[Array, "N", "m"]  # e_k - e_{k-1} [bar]
    end: Annotated[Array, "xi"]  # ξ


class Point(NamedTuple):
    """Decisions of the QP and their states in the linear model."""

    xi: Annotated[Array, "N + 1", "xi"]  # ξ = (δx, w): w_k is the deviation of the command k - 1 [bar]
    v: Annotated[Array, "N", "m"]  # changes of that deviation [bar]
    sigma: Annotated[Array, 2]  # slacks s [rad] and s_F [N]


class Bounded(NamedTuple):
    """Bounds of changes by the slew, of commands by the supply, and of the slacks, in the last line."""

    lower: Annotated[Array, "N + 1", "m"]  # of changes [bar]
    upper: Annotated[Array, "N + 1", "m"]  # [bar]
    low: Annotated[Array, "N + 1", "m"]  # of commands; at the start of a block, for the whole block [bar]
    high: Annotated[Array, "N + 1", "m"]  # [bar]
    there: Annotated[Mask, "N"]  # whether there is a change, at the starts of blocks; else the bounds are 0


class Given(NamedTuple):
    """New data of a step."""

    x: Annotated[Array, "x"]
    u: Annotated[Array, "N", "m"]  # initial commands [Pa]
    d: Annotated[Array, "N * n"]  # [N·m]
    reference: Reference
    last: Annotated[Array, 2, "m"]  # command and feed-forward of the previous sample [Pa]


class Along(NamedTuple):
    """Path and its commands."""

    path: Path
    u: Annotated[Array, "N", "m"]  # [bar]


def sizes_of(n: int, m: int, stiffnesses: int) -> dict[str, int]:
    """Return the sizes of records of `n` joints and `m` muscles, with so many entries of svec K, by their names.

    They are n, m, the k k entries of K, those s of svec K, and those of a state x, of outputs y and of ξ.
    """
    x = 2 * n + m
    kk = isqrt(2 * stiffnesses) ** 2
    return {"n": n, "m": m, "kk": kk, "s": stiffnesses, "x": x, "y": stiffnesses + m, "xi": x + m}


_JOINT = sizes_of(JOINTS, NU, STIFFNESSES)
setting_in: Callable[[Array, Indices], Setting] = viewer(Setting, _JOINT)
given_in: Callable[[Array], Given] = viewer(Given, _JOINT)
path_in: Callable[[Array], Along] = viewer(Along, _JOINT)


def lengths(N: int) -> tuple[int, int]:
    """Return the lengths of the buffers of a `Given` and of a path of a joint."""
    return length_of(Given, N, known=_JOINT), length_of(Along, N, known=_JOINT)
