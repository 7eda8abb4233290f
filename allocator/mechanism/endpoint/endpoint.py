"""Hand of a mechanism: a point moved by the joints, which exerts a force f and has a stiffness K_x.

With x = x(q) and J = ∂x/∂q, equilibrium under the force of the hand is τ = Jᵀf; its derivative is

    K_q = Jᵀ K_x J - Γ(f),     Γ_ab = Σ_i f_i ∂²x_i/∂q_a∂q_b                                    (M4)

An invertible J maps K_x and K_q one to one. With more joints than coordinates many K_q have the same K_x: the free
joints follow, so the inverse is the compliance of the hand, K_x⁻¹ = J (K_q + Γ)⁻¹ Jᵀ.

The position of the hand over the posture is a point on a linkage in closed form, or a CasADi function.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.routes.functions import SymbolicColumn
from allocator.mechanism.routes.linkage import Link, Linkage, Site

if TYPE_CHECKING:
    from allocator.mechanism.routes.mjcf import Source

_AXES = "xyz"


class Place(NamedTuple):
    """Position of an endpoint at postures (…), with its derivatives; dim coordinates, n joints."""

    position: Array  # x (…, dim) [m]
    jacobian: Array  # J = ∂x/∂q (…, dim, n) [m/rad]
    hessian: Array  # ∂²x/∂q² (…, dim, n, n) [m/rad²]


class Kinematics(Protocol):
    """Interface of an `Endpoint`'s kinematics: x(q) and its derivatives."""

    @property
    def n(self) -> int:
        """Number of joints."""
        ...

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        ...

    def at(self, q: Array) -> Place:
        """Return the place at the postures `q` (…, n)."""
        ...


@dataclass(frozen=True)
class LinkagePoint:
    """Point on one of the links, with the coordinates `axes`."""

    linkage: Linkage
    site: Site
    axes: str  # of the ground's frame, such as "xy"

    def __post_init__(self) -> None:
        """Check the axes. Raises `InvalidInput`."""
        axes = self.axes
        if not isinstance(axes, str) or not axes or len(set(axes)) != len(axes) or set(axes) - set(_AXES):
            raise InvalidInput(f"Endpoint: axes = {axes!r} have to be different letters of {_AXES!r}, such as 'xy'")

    @classmethod
    def on(cls, linkage: Linkage, link: int, position: object, axes: str) -> Self:
        """Return the point at `position` [m] on a link. Raises `InvalidInput`."""
        return cls(linkage, linkage.site("Endpoint: the point is on", link, position), axes)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.linkage.n

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        return len(self.axes)

    def at(self, q: Array) -> Place:
        """Return the place at the postures `q` (…, n)."""
        moved, axes = self.linkage.point(self.site, self.linkage.frames(q)), [_AXES.index(axis) for axis in self.axes]
        return Place(
            moved.position[..., axes],
            moved.slope[..., axes].swapaxes(-1, -2),
            np.moveaxis(moved.curve[..., axes], -1, -3),
        )


@dataclass(frozen=True)
class FunctionPoint:
    """Coordinates x(q) by a user's function of a CasADi vector q (n,)."""

    joints: int
    function: Callable[[Value], Value]

    def __post_init__(self) -> None:
        """Raise `InvalidInput` unless the function returns an expression."""
        object.__setattr__(self, "joints", checks.count("Endpoint.from_function: n", self.joints, 1))
        _ = self._column.expression

    @cached_property
    def _column(self) -> SymbolicColumn:
        return SymbolicColumn("Endpoint.from_function", self.joints, self.function)

    def column(self, q: Value) -> Value:
        """Return x (dim, 1) as a formula of the CasADi column `q` (n, 1)."""
        import casadi as ca

        symbol, value = self._column.expression
        return ca.substitute(value, symbol, q)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.joints

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        return self._column.size

    def at(self, q: Array) -> Place:
        """Return the place at the postures `q` (…, n). Raises `InvalidInput` if a derivative is not finite."""
        return Place(*self._column.at(q))


_SINGULAR = 1e-9  # of the greatest singular value of J
_STILL = 1e-9  # [m/rad] or of the greatest: a smaller motion of a point counts as none
_LONGEST = 10.0  # [m] a longer link is in millimetres
_SYMMETRIC = 1e-9  # of the greatest entry


@dataclass(frozen=True)
class Endpoint:
    """Point whose coordinates x(q) ∈ R^dim depend on n joints; immutable.

    Postures are (…, n), forces (…, dim), leading axes broadcast. Coordinates are lengths [m]; those of a user's
    function may also be angles [rad], with moments for forces.
    """

    kinematics: Kinematics

    @classmethod
    def planar(cls, lengths: ArrayLike, at_zero: ArrayLike = 0.0) -> Self:
        """Return the hand of an arm in the plane with n hinges and links of these `lengths` (n,) [m]; dim = 2.

        `at_zero` (n,) [rad] are the angles at q = 0 of each link to the previous one, the first to the axis x. By
        default all are 0: the arm is stretched out along x. They add up anticlockwise. Raises `InvalidInput`.
        """
        row = checks.real("Endpoint.planar: lengths", lengths, "m")
        if row.ndim != 1 or not row.size:
            raise InvalidInput(f"Endpoint.planar: lengths have the shape {row.shape}; expected a row of n links [m]")
        if (wrong := (row <= 0) | (row > _LONGEST)).any():
            raise InvalidInput(
                f"Endpoint.planar: lengths{checks.at(row, wrong)} m is no link; if millimetres, divide by 1000"
            )
        bent = checks.angle("Endpoint.planar: at_zero", at_zero)
        if bent.shape not in ((), row.shape):
            raise InvalidInput(f"Endpoint.planar: at_zero has the shape {bent.shape}; one angle for each of {row.size}")
        starts = [0.0, *row.tolist()[:-1]]
        angles = np.broadcast_to(bent, row.shape).tolist()
        links = [Link(i - 1, (start, 0.0), zero=-angles[i]) for i, start in enumerate(starts)]
        return cls.on_link(links, row.size - 1, (float(row[-1]), 0.0), axes="xy")

    @classmethod
    def on_link(cls, links: Sequence[Link], link: int, position: object, *, axes: str = "xyz") -> Self:
        """Return the point at `position` [m], two or three numbers, in the frame of `links[link]`.

        `axes` selects its coordinates: "xyz", "xy", … Raises `InvalidInput`.
        """
        return cls(LinkagePoint.on(Linkage(links), link, position, axes))

    @classmethod
    def from_mjcf(cls, file: "Source", name: str, *, axes: str = "xyz") -> Self:
        """Return the site of a MuJoCo model with this `name`, or else the origin of the body with this name.

        Joints are those of `Mechanism.from_mjcf` of the same file. Needs `antagonist[mujoco]`. Raises `InvalidFile`,
        `InvalidInput` and `MissingBackend`.
        """
        from allocator.mechanism.routes.mjcf import read_point

        return cls(LinkagePoint(*read_point(file, name), axes))

    @classmethod
    def from_function(cls, n: int, function: Callable[[Value], Value]) -> Self:
        """Return the endpoint at `function(q)`, a CasADi expression (dim,) of a vector q (n,).

        Raises `InvalidInput`.
        """
        return cls(FunctionPoint(n, function))

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.kinematics.n

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        return self.kinematics.dim

    # --- at postures ------------------------------------------------------------------------------------------------

    def at(self, q: Array) -> Place:
        """Return position and derivatives at the postures `q` (…, n), without checks."""
        return self.kinematics.at(q)

    def position(self, q: ArrayLike) -> Array:
        """Return x (…, dim) [m] at the postures `q` (…, n) [rad]."""
        return self.at(self.posture(q)).position

    def jacobian(self, q: ArrayLike) -> Array:
        """Return J = ∂x/∂q (…, dim, n) [m/rad] at the postures `q` (…, n) [rad]."""
        return self.at(self.posture(q)).jacobian

    def hessian(self, q: ArrayLike) -> Array:
        """Return ∂²x/∂q² (…, dim, n, n) [m/rad²] at the postures `q` (…, n) [rad]."""
        return self.at(self.posture(q)).hessian

    def torque(self, q: ArrayLike, force: ArrayLike) -> Array:
        """Return the torques Jᵀf (…, n) [N·m] in equilibrium with the hand's `force` (…, dim) [N]."""
        return torque_of(self.at(self.posture(q)), self.force(force))

    def joint_stiffness(self, q: ArrayLike, K_x: ArrayLike, force: ArrayLike = 0.0) -> Array:
        """Return K_q = Jᵀ K_x J - Γ(f) (…, n, n) [N·m/rad] of a stiffness `K_x` (…, dim, dim) [N/m]   (M4)

        With more joints than coordinates it is the least one: K_q + N with any N ⪰ 0 in the null space of J has no
        lower K_x. Raises `InvalidInput`.
        """
        place = self.at(self.posture(q))
        K = self._matrix("K_x", K_x, self.dim, "N/m")
        J = place.jacobian
        return np.asarray(J.swapaxes(-1, -2) @ K @ J - load_of(place, self.force(force)))

    def stiffness(self, q: ArrayLike, K_q: ArrayLike, force: ArrayLike = 0.0) -> Array:
        """Return K_x = (J (K_q + Γ(f))⁻¹ Jᵀ)⁻¹ (…, dim, dim) [N/m] of a joint stiffness `K_q` (…, n, n) [N·m/rad].

        NaN if the joints are unstable in the null space of J. Raises `InvalidInput`, also if J does not have the rank
        dim: no joint moves the hand in some direction.
        """
        place = self.at(self.posture(q))
        self.check_rank(place)
        K = self._matrix("K_q", K_q, self.n, "N·m/rad")
        return stiffness_of(place, K + load_of(place, self.force(force)))

    # --- checks -----------------------------------------------------------------------------------------------------

    def posture(self, q: object) -> Array:
        """Return the checked postures `q` (…, n) [rad]. Raises `InvalidInput`."""
        array = checks.angle("q", q)
        if array.ndim == 0 or array.shape[-1] != self.n:
            raise InvalidInput(f"q has the shape {array.shape}; expected (…, {self.n}) of {self.text}")
        return array

    def force(self, force: object) -> Array:
        """Return the checked forces (…, dim) [N]; 0 is none. Raises `InvalidInput`."""
        array = checks.real("force", force, "N")
        if array.ndim == 0 and float(array) == 0.0:
            return np.zeros(self.dim)
        if array.ndim == 0 or array.shape[-1] != self.dim:
            raise InvalidInput(f"force has the shape {array.shape}; expected (…, {self.dim}) [N] of {self.text}")
        return array

    def check_rank(self, place: Place) -> None:
        """Raise `InvalidInput` unless joints move the hand in every direction."""
        if self.n < self.dim:
            raise InvalidInput(
                f"{self.dim} coordinates of {self.text}: n joints move at most n of them; leave some out (axes='xy')"
            )
        sizes = np.linalg.svd(place.jacobian, compute_uv=False)
        if (wrong := sizes[..., -1] <= _SINGULAR * sizes[..., 0]).any():
            x = place.position[wrong].reshape(-1, self.dim)[0]
            raise InvalidInput(
                f"the Jacobian is singular at x = ({', '.join(f'{value:.4g}' for value in x)}) m, such as of an arm "
                "stretched out: a direction of the endpoint is moved by no joint, and its stiffness is infinite"
            )

    def _matrix(self, name: str, value: object, size: int, unit: str) -> Array:
        array = checks.real(name, value, unit)
        if array.ndim < 2 or array.shape[-2:] != (size, size):
            raise InvalidInput(
                f"{name} has the shape {array.shape}; expected (…, {size}, {size}) [{unit}] of {self.text}"
            )
        if (np.abs(array - array.swapaxes(-1, -2)) > _SYMMETRIC * np.abs(array).max(initial=0.0)).any():
            raise InvalidInput(f"{name} is not symmetric: a stiffness is, K_ij = K_ji [{unit}]")
        return array

    @property
    def text(self) -> str:
        """Description in a few words."""
        return f"an endpoint with dim = {self.dim} coordinates over n = {self.n} joints"


def torque_of(place: Place, force: Array) -> Array:
    """Return Jᵀf (…, n) [N·m]."""
    return np.asarray((place.jacobian.swapaxes(-1, -2) @ force[..., None])[..., 0])


def load_of(place: Place, force: Array) -> Array:
    """Return Γ(f) = Σ f_i ∂²x_i/∂q² (…, n, n) [N·m/rad]."""
    return np.asarray((place.hessian * force[..., :, None, None]).sum(axis=-3))


def inverses(place: Place) -> tuple[Array, Array]:
    """Return (J⁺ (…, n, dim), an orthonormal basis N (…, n, n - dim) of the null space of J); J has the rank dim."""
    U, s, V = np.linalg.svd(place.jacobian, full_matrices=True)
    dim, V = s.shape[-1], V.swapaxes(-1, -2)
    return (V[..., :dim] / s[..., None, :]) @ U.swapaxes(-1, -2), V[..., dim:]


def lifted(place: Place, K: Array) -> Array:
    """Return G (…, n, dim), J G = 1: the motion of the joints with `K` = K_q + Γ by a motion of the hand.

    Of all G with J G = 1 it has the least Gᵀ K G, which is K_x. NaN if the joints are unstable in the null space of J.
    """
    plus, unseen = inverses(place)
    if not unseen.shape[-1]:
        return plus
    across = unseen.swapaxes(-1, -2) @ K
    own = across @ unseen
    falls = ~(np.linalg.eigvalsh(own)[..., :1, None] > 0)
    G = plus - unseen @ np.linalg.solve(np.where(falls, np.eye(own.shape[-1]), own), across @ plus)
    return np.where(falls, np.nan, G)


def stiffness_of(place: Place, K: Array) -> Array:
    """Return K_x = Gᵀ K G (…, dim, dim) [N/m] of `K` = K_q + Γ (…, n, n)."""
    G = lifted(place, K)
    return np.asarray(G.swapaxes(-1, -2) @ K @ G)


def hand_of_model(file: "Source", text: str, mechanism: Mechanism) -> Endpoint | None:
    """Return the hand of a MuJoCo model, a site or a body, with some of its coordinates: "tip", or "tip:xz".

    Without coordinates it has those that the joints of the `mechanism` move most, at most as many as there are joints.
    None if they move none. Raises the errors of `Endpoint.from_mjcf`.
    """
    name, _, axes = text.partition(":")
    point = Endpoint.from_mjcf(file, name, axes=axes or _AXES)
    return point if axes else _moved(point, mechanism)


def _moved(point: Endpoint, mechanism: Mechanism) -> Endpoint | None:
    low, high = (-1.0, 1.0) if mechanism.angle_limits is None else np.transpose(mechanism.angle_limits)
    shares = np.random.default_rng(0).random((32, mechanism.n))
    J = point.jacobian(low + shares * (np.asarray(high) - low))
    sizes = np.linalg.svd(J, compute_uv=False)
    rank = int((sizes.max(axis=0) > _STILL * max(sizes.max(), _STILL)).sum())
    most = np.sort(np.argsort(-(J**2).sum(axis=(0, 2)), kind="stable")[:rank])
    kinematics: Any = point.kinematics
    return replace(point, kinematics=replace(kinematics, axes="".join(_AXES[i] for i in most))) if rank else None
