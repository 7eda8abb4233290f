"""Formulas of trees of bodies connected by hinges, in space.

They are those of J. Y. S. Luh, M. W. Walker and R. P. C. Paul, "On-Line Computational Scheme for Mechanical
Manipulators", J. Dyn. Sys. Meas. Control 102 (1980), in the frames of the links, from the ground outwards

    w = Rᵀ w_p + s q',   w' = Rᵀ w_p' + (Rᵀ w_p) × s q' + s q'',   a = Rᵀ (a_p + w_p' × o + w_p × (w_p × o)),   a_0 = -γ

with s the axis, o the position of the hinge and R(q) the rotation of a link in its parent p; and inwards the forces

    f = m (a + w' × c + w × (w × c)) + Σ R f_i,      t = I w' + w × I w + c × (f of its own) + Σ (R t_i + o_i × R f_i)
    τ = s·t + J q'' + D q' + k (q - q_0)

which is linear in q'': M(q) is the slope, the rest the bias.
"""

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value, is_symbol
from allocator.errors import InvalidInput
from allocator.lazy import SX, Function
from allocator.mechanism.routes.linkage import GROUND, Link, Linkage

if TYPE_CHECKING:
    from mujoco import MjModel

_Moved: TypeAlias = tuple["SX", "SX", "SX"]
_UNITS = {
    "mass": "kg", "centre": "m", "inertia": "kg·m²", "damping": "N·m·s/rad", "armature": "kg·m²",
    "spring": "N·m/rad", "spring_zero": "rad",
}  # fmt: skip
_TURNS = 1e-12  # [-] of the greatest entry: least inertia about a hinge, with all angles at 0
_SYMMETRIC = 1e-9
_VECTORS = "torque", "bias", "gravity_torque"  # of the formulas; the others are matrices


@dataclass(frozen=True, eq=False)
class TreeBodies:
    """Rigid bodies, one on each of n `links` with hinges; immutable.

    Postures and velocities are (…, n) [rad], [rad/s] as numbers, or CasADi columns (n, 1) for formulas.
    """

    links: tuple[Link, ...]
    mass: Array  # m (n,) [kg]; 0 for a link between two hinges of one body
    centre: Array  # c (n, 3) [m] of mass, in the link's frame with the origin on its hinge
    inertia: Array  # I (n, 3, 3) [kg·m²] about the centre, in the link's frame
    damping: Array  # D (n,) [N·m·s/rad]
    armature: Array  # J (n,) [kg·m²] turning with a hinge, such as a pulley's or a motor's
    spring: Array  # k (n,) [N·m/rad]
    spring_zero: Array  # q_0 (n,) [rad]
    gravity: Value = (0.0, 0.0, 0.0)  # γ (3,) [m/s²]
    model: "MjModel | None" = field(default=None, repr=False)  # that they were read from

    def __post_init__(self) -> None:
        """Check the fields and convert them to arrays. Raises `InvalidInput`."""
        links = Linkage(self.links).links
        object.__setattr__(self, "links", links)
        n = len(links)
        if not n or any(link.kind != "hinge" for link in links):
            raise InvalidInput("TreeBodies: links have to be one or more, all on hinges")
        shapes = {"centre": (n, 3), "inertia": (n, 3, 3), "gravity": (3,)}
        for f in fields(self)[1:-1]:
            shape, unit = shapes.get(f.name, (n,)), _UNITS.get(f.name, "m/s²")
            array = checks.real(f"TreeBodies: {f.name}", getattr(self, f.name), unit)
            if array.shape not in ((), shape):
                raise InvalidInput(f"TreeBodies: {f.name} has the shape {array.shape}; expected {shape} [{unit}]")
            array = np.broadcast_to(array, shape).astype(float)
            if f.name not in ("centre", "inertia", "spring_zero", "gravity") and (array < 0).any():
                raise InvalidInput(f"TreeBodies: {f.name}{checks.at(array, array < 0)} {unit} has to be 0 or more")
            array.setflags(write=False)  # the compiled formulas have these numbers
            object.__setattr__(self, f.name, array)
        I = self.inertia  # noqa: E741
        if (np.abs(I - I.swapaxes(1, 2)) > _SYMMETRIC * np.abs(I).max(initial=0.0)).any() or (
            np.linalg.eigvalsh(I) < -_SYMMETRIC * np.abs(I).max(initial=0.0)
        ).any():
            raise InvalidInput("TreeBodies: inertia has to be symmetric and not negative [kg·m²]")
        sizes = np.linalg.eigvalsh(self.mass_matrix(np.array([link.zero for link in links])))
        if not sizes[0] > _TURNS * sizes[-1] or not sizes[-1] > 0:
            raise InvalidInput("TreeBodies: a hinge turns nothing that has an inertia; give masses, or an armature")

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.links)

    @property
    def summary(self) -> str:
        """Short description."""
        return f"{float(self.mass.sum()):.3g} kg on {self.n} hinges"

    # --- formulas ---------------------------------------------------------------------------------------------------

    def torque_for(self, q: Value, omega: Value, alpha: Value) -> Value:
        """Return the joints' torques τ (…, n) [N·m] of a motion (inverse dynamics)."""
        return self._evaluated("torque", q, omega, alpha)

    def mass_matrix(self, q: Value) -> Value:
        """Return M(q) (…, n, n) [kg·m²], symmetric and positive definite."""
        return self._evaluated("mass_matrix", q)

    def bias(self, q: Value, omega: Value) -> Value:
        """Return the torques (…, n) [N·m] of a motion without acceleration."""
        return self._evaluated("bias", q, omega)

    def gravity_torque(self, q: Value) -> Value:
        """Return g(q) (…, n) [N·m], the torques that balance gravity and springs."""
        return self._evaluated("gravity_torque", q)

    def gravity_stiffness(self, q: Value) -> Value:
        """Return ∂g/∂q (…, n, n) [N·m/rad], the stiffness due to gravity and springs."""
        return self._evaluated("gravity_stiffness", q)

    # --- the pieces -------------------------------------------------------------------------------------------------

    @cached_property
    def _functions(self) -> dict[str, "Function"]:
        import casadi as ca

        q, omega, alpha = (ca.SX.sym(name, self.n) for name in ("q", "omega", "alpha"))
        zero = ca.SX.zeros(self.n)
        torque, held = self._recursion(q, omega, alpha), self._recursion(q, zero, zero)
        made = {
            "torque": ([q, omega, alpha], torque),
            "mass_matrix": ([q], ca.jacobian(torque, alpha)),
            "bias": ([q, omega], self._recursion(q, omega, zero)),
            "gravity_torque": ([q], held),
            "gravity_stiffness": ([q], ca.jacobian(held, q)),
        }
        return {name: ca.Function(name, given, [ca.densify(value)]) for name, (given, value) in made.items()}

    def _evaluated(self, name: str, *given: Value) -> Value:
        """Return a formula, or its numbers for stacks of postures."""
        function = self._functions[name]
        if any(is_symbol(value) for value in given):
            return function(*given)
        arrays = np.broadcast_arrays(*(np.asarray(value, float) for value in given))
        if not arrays[0].ndim or arrays[0].shape[-1] != self.n:
            raise InvalidInput(f"q has the shape {arrays[0].shape}; expected (…, {self.n}) of n = {self.n} hinges")
        shape, flat = arrays[0].shape[:-1], [array.reshape(-1, self.n) for array in arrays]
        found = np.atleast_2d(function(*(array.T for array in flat)).full())
        stacked = found.reshape(self.n, len(flat[0]), -1).swapaxes(0, 1)
        return np.asarray(stacked.reshape(*shape, self.n, *(() if name in _VECTORS else (self.n,))))

    def _recursion(self, q: "SX", omega: "SX", alpha: "SX") -> "SX":
        """Return the torques (n, 1) of a motion as a formula."""
        import casadi as ca

        turned, moved = self._outwards(q, omega, alpha)
        forces, moments = [ca.SX.zeros(3)] * self.n, [ca.SX.zeros(3)] * self.n
        torque = ca.SX.zeros(self.n)
        for i in reversed(range(self.n)):
            link, (w, dw, a) = self.links[i], moved[i]
            c, I = ca.DM(self.centre[i]), ca.DM(self.inertia[i])  # noqa: E741
            own = float(self.mass[i]) * (a + ca.cross(dw, c) + ca.cross(w, ca.cross(w, c)))
            f, t = own + forces[i], I @ dw + ca.cross(w, I @ w) + ca.cross(c, own) + moments[i]
            torque[i] = (
                ca.dot(ca.DM(link.axis), t)
                + float(self.armature[i]) * alpha[i]
                + float(self.damping[i]) * omega[i]
                + float(self.spring[i]) * (q[i] - float(self.spring_zero[i]))
            )
            if (p := link.parent) != GROUND:
                f, t = turned[i] @ f, turned[i] @ t
                forces[p] = forces[p] + f
                moments[p] = moments[p] + t + ca.cross(ca.DM(link.origin), f)
        return torque

    def _outwards(self, q: "SX", omega: "SX", alpha: "SX") -> tuple[list["SX"], list[_Moved]]:
        """Return every link's rotation in its parent, angular rates, and the acceleration of its origin."""
        import casadi as ca

        still = ca.SX.zeros(3)
        ground = still, still, ca.SX(ca.DM(-self.gravity))
        turned: list[SX] = []
        moved: list[_Moved] = []
        for i, link in enumerate(self.links):
            w, dw, a = ground if link.parent == GROUND else moved[link.parent]
            s, o, angle = ca.DM(link.axis), ca.DM(link.origin), q[i] - link.zero
            W = ca.skew(s)
            R = ca.DM(np.array(link.orientation)) @ (ca.DM.eye(3) + ca.sin(angle) * W + (1 - ca.cos(angle)) * (W @ W))
            turned.append(R)
            w_in = R.T @ w
            moved.append((
                w_in + s * omega[i],
                R.T @ dw + ca.cross(w_in, s * omega[i]) + s * alpha[i],
                R.T @ (a + ca.cross(dw, o) + ca.cross(w, ca.cross(w, o))),
            ))  # fmt: skip
        return turned, moved
