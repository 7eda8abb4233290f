"""Which stiffness ellipses a hand can have over its workspace: the softest, the stiffest, and how far they turn.

The stiffness of a hand in the plane is a size (its trace), and the vector

    v = ((K_xx - K_yy)/2, K_xy),

whose length says how far the ellipse is from a circle and whose angle is twice the tilt of its long axis. All are
linear in K_x: with the torques held, the trace has two ends, and v fills a polygon, whose border has the tilts that
exist.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.joint.gas import Stiffness
from allocator.joint.limits import TAUT, Limits
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.feasibility.polygon import Polygon
from allocator.mechanism.feasibility.targets import FeasibleTargets, feasible_targets
from allocator.mechanism.mechanism import Mechanism

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TRACE = {"Kx11": 1.0, "Kx22": 1.0}
_ACROSS = {"Kx11": 0.5, "Kx22": -0.5}


@dataclass(frozen=True, eq=False)
class EndpointEllipses:
    """`EndpointEllipses` are what a hand in the plane can have at postures (…), NaN where the torques do not exist."""

    q: Array  # (…, 2) [rad]
    x: Array  # where the hand is (…, 2) [m]
    softest: Array  # K_x of the least trace (…, 2, 2) [N/m]
    stiffest: Array  # and of the greatest
    tilt: Array  # of the long axis from x anticlockwise, least and greatest (…, 2) [rad]; π apart where all exist

    @property
    def exists(self) -> Mask:
        """Return whether there are pressures that give the torques (…)."""
        return np.isfinite(self.softest[..., 0, 0])

    def plot(self, axes: "Axes | None" = None) -> Any:
        """Draw the ellipses where the hand is; returns the Matplotlib axes."""
        from allocator.mechanism.pictures import plot_workspace

        return plot_workspace(self, axes)


def endpoint_ellipses(
    mechanism: Mechanism,
    endpoint: Endpoint,
    q: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    force: ArrayLike = 0.0,
    limits: Limits = TAUT,
) -> EndpointEllipses:
    """Return the softest and the stiffest ellipse of a hand in the plane at postures `q` (…, 2) [rad], and its tilts.

    The torques are held: `T` (…, 2) [N·m] or a number, and those of the `force` (2,) [N] that the hand exerts. Raises
    `InvalidInput`, also for other than two joints and two coordinates, and where the Jacobian is singular.
    """
    if not isinstance(endpoint, Endpoint) or (endpoint.n, endpoint.dim) != (2, 2):
        what = endpoint.text if isinstance(endpoint, Endpoint) else f"a {type(endpoint).__name__}"
        raise InvalidInput(
            f"the ellipses are those of an endpoint with dim = 2 coordinates over n = 2 joints, not {what}"
        )
    postures = mechanism.posture(q)
    flat = postures.reshape(-1, 2)
    torques = np.broadcast_to(np.asarray(T, float), postures.shape).reshape(-1, 2) + endpoint.torque(flat, force)
    found = []
    for one, torque in zip(flat, torques, strict=True):
        at = feasible_targets(mechanism, one, stiffness=Stiffness(endpoint=endpoint, force=force), limits=limits)
        found.append(_at(at, torque))
    shape = postures.shape[:-1]
    softest, stiffest, tilt = (np.array([row[i] for row in found]) for i in range(3))
    return EndpointEllipses(
        postures,
        endpoint.position(postures),
        softest.reshape(*shape, 2, 2),
        stiffest.reshape(*shape, 2, 2),
        tilt.reshape(*shape, 2),
    )


def _at(feasible: FeasibleTargets, torque: Array) -> tuple[Array, Array, Array]:
    """Return the softest and the stiffest K_x, and the tilts, at one posture."""
    held = {f"T{i + 1}": float(value) for i, value in enumerate(torque)}
    low, high = (feasible.attaining(_TRACE, sign, held) for sign in (-1.0, 1.0))
    if low is None or high is None:
        return np.full((2, 2), np.nan), np.full((2, 2), np.nan), np.full(2, np.nan)
    return (
        feasible.endpoint_stiffness(low),
        feasible.endpoint_stiffness(high),
        _tilts(feasible.polygon(_ACROSS, "Kx12", held)),
    )


def _tilts(polygon: Polygon) -> Array:
    """Return the least and the greatest half angle of a polygon's points."""
    if bool(polygon.contains(0.0, 0.0)):
        return np.array([-np.pi / 2, np.pi / 2])
    x, y = polygon.vertices.T
    middle = np.arctan2(y.mean(), x.mean())
    around = (np.arctan2(y, x) - middle + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(0.5 * (middle + np.array([around.min(), around.max()])))
