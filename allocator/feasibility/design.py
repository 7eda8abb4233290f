"""`performance` says what a design of joint can do: range, stiffness band, torque reserve.

A design is good if the joint reaches far, if there is a band of stiffnesses that it can hold over its whole range, and
if torque is left at every angle. Each is an extreme over the joint range of an end of `stiffness_interval` or
`torque_interval`, so that a design costs milliseconds; `design_sweep` runs many, here or on a cluster.
"""

from collections.abc import Iterable, Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.feasibility.setting import Setting
from allocator.feasibility.spans import lowest, spans
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.geometry import Pulley
from allocator.joint.limits import Limits
from allocator.joint.torque_levels import torque_interval
from allocator.muscles import Muscle
from allocator.muscles.catalogue import TONDU_DMSP_20_400N

_PIECES = 64  # of the joint range in which extremes are looked for


class Design(NamedTuple):
    """Joint design with two equal muscles on a pulley; the defaults are those of the report."""

    radius: float = 0.02  # R [m]
    rest_length: float = 0.40  # l0 [m]
    initial_contraction: float = 0.1375  # ε0 [-]
    supply_pressure: float = 5e5  # [Pa]

    def joint(self, muscle: Muscle = TONDU_DMSP_20_400N, stops: tuple[float, float] | None = None) -> AntagonistJoint:
        """Return the joint of this design, with mechanical end stops [rad] if there are any."""
        pulley = Pulley(self.rest_length, self.radius, self.initial_contraction)
        return AntagonistJoint(pulley, muscle, muscle, (0.0, self.supply_pressure), angle_limits=stops)


_REPORT = Design()


class Performance(NamedTuple):
    """A `Performance` is what a design can do at no load, stiffnesses isobaric; NaN where there is nothing."""

    left: float  # joint range [rad]: the widest interval of angles that can be held without load
    right: float
    K_low: float  # the stiffnesses from K_low to K_high [N·m/rad] can be held over the whole range …
    K_high: float  # … none if K_low > K_high
    torque_reserve: float  # torque [N·m] that can be given at least, in both directions, at every angle of the range

    @property
    def range(self) -> float:
        """Return the width of the joint range [rad]."""
        return self.right - self.left

    @property
    def band(self) -> float:
        """Return the width of the band of stiffnesses that hold over the whole range [N·m/rad]; 0 if there is none."""
        return max(self.K_high - self.K_low, 0.0)


_NOTHING = Performance(*[np.nan] * 5)


def design_grid(
    radius: ArrayLike = _REPORT.radius,
    rest_length: ArrayLike = _REPORT.rest_length,
    initial_contraction: ArrayLike = _REPORT.initial_contraction,
    supply_pressure: ArrayLike = _REPORT.supply_pressure,
) -> tuple[Design, ...]:
    """Return all combinations of these radii [m], rest lengths [m], contractions [-] and supply pressures [Pa]."""
    axes = (
        checks.real("radius", radius, "m"),
        checks.real("rest_length", rest_length, "m"),
        checks.real("initial_contraction", initial_contraction, "-"),
        checks.pressure("supply_pressure", supply_pressure),
    )
    return tuple(Design(*map(float, values)) for values in product(*map(np.ravel, axes)))


def performance(
    design: Design,
    muscle: Muscle = TONDU_DMSP_20_400N,
    stops: tuple[float, float] | None = None,
    min_force: float = 0.0,
) -> Performance:
    """Return joint range, stiffness band and torque reserve of a design; all NaN if no angle can be held without load.

    Extremes over the range are found among 65 angles and refined. An initial contraction below the threshold leaves no
    angle at all and is answered so; other numbers that make no joint raise InvalidInput.
    """
    if design.initial_contraction <= AntagonistJoint.min_contraction:
        return _NOTHING
    setting = Setting.of(design.joint(muscle, stops), Limits(min_force))

    def held(theta: Array, T: Array) -> Array:
        found = setting.columns(theta, np.broadcast_to(T, theta.shape))
        return np.where(found.empty, -1.0, found.reach).reshape(theta.shape)

    left, right = spans(held, *setting.joint.angle_range, np.zeros(1), pieces=_PIECES)
    if not len(left):
        return _NOTHING
    widest = int(np.argmax(right - left))
    ends = float(left[widest, 0]), float(right[widest, 0])
    return Performance(*ends, *_extremes(setting, *ends))


def _extremes(setting: Setting, left: float, right: float) -> Iterator[float]:
    """Return greatest K_min, least K_max and least torque reserve between the angles left and right."""

    def negative_K_min(theta: Array) -> Array:
        return -setting.columns(theta, 0.0).K_min.reshape(theta.shape)

    def K_max(theta: Array) -> Array:
        return setting.columns(theta, 0.0).K_max.reshape(theta.shape)

    def reserve(theta: Array) -> Array:
        problem, _ = setting.problem(theta)
        T_min, T_max = torque_interval(problem.sides, problem.box)
        return np.minimum(-T_min, T_max).reshape(theta.shape)

    for function, sign in ((negative_K_min, -1.0), (K_max, 1.0), (reserve, 1.0)):
        at = lowest(function, np.array([left]), np.array([right]), pieces=_PIECES)
        yield sign * float(function(at)[0])


def checked(designs: Iterable[Design]) -> tuple[Design, ...]:
    """Return the designs, of which there has to be one at least."""
    found = tuple(designs)
    if not found:
        raise InvalidInput("design_sweep got no designs")
    if wrong := [d for d in found if not isinstance(d, Design)]:
        raise InvalidInput(f"design_sweep takes Design objects, not {wrong[0]!r}; see design_grid")
    return found
