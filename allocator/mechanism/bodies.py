"""Bodies of an arm: the links of a planar chain, each with a hinge at its beginning.

With the angles φ_i = σ_1 q_1 + … + σ_i q_i of the links against the x-axis (σ = ±1 are the senses of the joints), their
lengths l_i, masses m_i, distances a_i of the centres of mass from the hinge and inertias I_i about these, the energies
are

    ½ Σ_ij c_ij cos(φ_i - φ_j) φ_i' φ_j'     and     -Σ_j s_j (γ_x cos φ_j + γ_y sin φ_j)

    s_j = m_j a_j + l_j Σ_{k>j} m_k,    c_ij = l_i s_j (i < j),    c_ii = I_i + m_i a_i² + l_i² Σ_{k>i} m_k

with γ the vector of gravity in the plane; and τ = M(q) q'' + C(q, q') + D q' + g(q). The terms of q_i are the sums over
j ≥ i of those of φ_j, times σ_i, because q_i turns all links from its own on.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Value, cos, is_symbol, sin
from allocator.errors import InvalidInput
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.routes import Sites
from allocator.mechanism.routes.linkage import GROUND, Link, Linkage

EARTH = 9.81  # [m/s²]

_SAME = 1e-6  # [m] or [-] of frames of links
_UNITS = {"length": "m", "mass": "kg", "centre": "m", "inertia": "kg·m²", "damping": "N·m·s/rad"}
_MOST = {"length": 10.0, "mass": 1000.0, "centre": 10.0, "inertia": 1000.0, "damping": 1000.0, "gravity": 100.0}


@dataclass(frozen=True)
class Bodies:
    """Links of a planar serial chain with n hinges; immutable.

    At q = 0 all links lie along the x-axis; angles count in the joint's `sense`, each against the link before. A field
    of links is n numbers, or one number for all links if another field determines n. Postures and velocities are (…, n)
    [rad], [rad/s] as numbers, or CasADi columns (n, 1) for formulas.
    """

    length: tuple[float, ...]  # l (n,) [m]
    mass: tuple[float, ...]  # m (n,) [kg]
    centre: tuple[float, ...]  # a (n,) [m], of the centre of mass from the link's own hinge
    inertia: tuple[float, ...]  # I (n,) [kg·m²], about the centre of mass
    damping: tuple[float, ...]  # D (n,) [N·m·s/rad], of the hinge
    gravity: tuple[float, ...] = (0.0, 0.0)  # γ [m/s²] in the plane; 0: the plane is horizontal
    sense: tuple[int, ...] = ()  # σ (n,) of the joints: 1 anticlockwise, -1 clockwise; by default all 1

    def __post_init__(self) -> None:
        """Check the fields and convert them to floats. Raises `InvalidInput`."""
        arrays = {name: checks.real(f"Bodies: {name}", getattr(self, name), unit) for name, unit in _UNITS.items()}
        sizes = {name: array.shape for name, array in arrays.items() if array.ndim}
        n = next(iter(sizes.values()), (1,))
        if wrong := [name for name, shape in sizes.items() if shape != n or len(shape) != 1 or not shape[0]]:
            listed = ", ".join(f"{name} {shape}" for name, shape in sizes.items())
            raise InvalidInput(f"Bodies: {wrong[0]} has to be one number a link, as many as the others: {listed}")
        for name, array in arrays.items():
            least = "positive" if name in ("length", "mass", "inertia") else "0 or more"
            bad = (array <= 0 if least == "positive" else array < 0) | (array > _MOST[name])
            if bad.any():
                said = f"Bodies: {name}{checks.at(array, bad)} {_UNITS[name]}"
                raise InvalidInput(f"{said} has to be {least} and at most {_MOST[name]:g}")
            object.__setattr__(self, name, tuple(np.broadcast_to(array, n).tolist()))
        gravity = checks.real("Bodies: gravity", self.gravity, "m/s²")
        if gravity.shape != (2,) or (np.abs(gravity) > _MOST["gravity"]).any():
            raise InvalidInput(f"Bodies: gravity = {checks.brief(self.gravity)} has to be (x, y) in the plane [m/s²]")
        object.__setattr__(self, "gravity", tuple(gravity.tolist()))
        sense = checks.real("Bodies: sense", self.sense if len(self.sense) else np.ones(n), "-")
        if sense.shape != n or not (np.abs(sense) == 1).all():
            raise InvalidInput(f"Bodies: sense = {checks.brief(self.sense)} has to be 1 or -1 of each of {n[0]} joints")
        object.__setattr__(self, "sense", tuple(map(int, sense)))

    @classmethod
    def rods(
        cls,
        length: Sequence[float],
        mass: Sequence[float],
        damping: ArrayLike,
        gravity: Sequence[float] = (0.0, 0.0),
        sense: tuple[int, ...] = (),
    ) -> Self:
        """Return links that are thin uniform rods: a = l/2, I = m l²/12. Raises `InvalidInput`."""
        size, m = checks.real("Bodies: length", length, "m"), checks.real("Bodies: mass", mass, "kg")
        if size.shape != m.shape:
            raise InvalidInput(f"Bodies: length {size.shape} and mass {m.shape} have to be one number a link")
        own = size / 2, m * size**2 / 12
        return cls(_row(size), _row(m), _row(own[0]), _row(own[1]), _row(damping), gravity, sense)  # type: ignore[arg-type]

    @property
    def n(self) -> int:
        """Number of links, and of joints."""
        return len(self.length)

    @property
    def links(self) -> tuple[Link, ...]:
        """Chain as links of a `Linkage`."""
        ends = [0.0, *self.length]
        return tuple(Link(i - 1 if i else GROUND, (ends[i], 0.0), (0.0, 0.0, s)) for i, s in enumerate(self.sense))

    @property
    def endpoint(self) -> Endpoint:
        """End of the last link, with its coordinates in the plane; of a single link y alone."""
        axes = "xy" if self.n > 1 else "y"
        return Endpoint.on_link(self.links, self.n - 1, (self.length[-1], 0.0), axes=axes)

    @property
    def summary(self) -> str:
        """Short description."""
        lengths, masses = (", ".join(f"{value:g}" for value in row) for row in (self.length, self.mass))
        return f"links of {lengths} m and {masses} kg"

    # --- formulas ---------------------------------------------------------------------------------------------------

    def mass_matrix(self, q: Value) -> Value:
        """Return M(q) (…, n, n) [kg·m²], symmetric and positive definite."""
        phi, c = self._angles(q), self._coupling.tolist()
        absolute = [[c[i][j] * cos(phi[i] - phi[j]) for j in range(self.n)] for i in range(self.n)]
        rows = [[_sum(absolute[a][b] for a in range(i, self.n) for b in range(j, self.n)) for j in range(self.n)]
                for i in range(self.n)]  # fmt: skip
        return _matrix([[si * sj * M for sj, M in zip(self.sense, row, strict=True)]
                        for si, row in zip(self.sense, rows, strict=True)], q)  # fmt: skip

    def coriolis(self, q: Value, omega: Value) -> Value:
        """Return the Coriolis and centrifugal torques C(q, q') (…, n) [N·m]."""
        phi, turning, c = self._angles(q), self._angles(omega), self._coupling.tolist()
        of_links = [
            _sum(c[i][j] * sin(phi[i] - phi[j]) * turning[j] ** 2 for j in range(self.n) if j != i)
            for i in range(self.n)
        ]
        return _vector(self._carried(of_links), q)

    def gravity_torque(self, q: Value) -> Value:
        """Return g(q) (…, n) [N·m], the slope of the potential, which the muscles have to balance."""
        (x, y), s = self.gravity, self._moments.tolist()
        if x == y == 0 and not is_symbol(q):  # a horizontal plane, where most studies are
            return np.zeros_like(np.asarray(q, float))
        of_links = [s[j] * (x * sin(angle) - y * cos(angle)) for j, angle in enumerate(self._angles(q))]
        return _vector(self._carried(of_links), q)

    def gravity_stiffness(self, q: Value) -> Value:
        """Return ∂g/∂q (…, n, n) [N·m/rad], symmetric, the stiffness due to gravity."""
        (x, y), s, n = self.gravity, self._moments, self.n
        of_links = [s[j] * (x * cos(angle) + y * sin(angle)) for j, angle in enumerate(self._angles(q))]
        carried, sense = self._carried(of_links), self.sense  # each with the sense of its joint
        return _matrix([[sense[min(i, j)] * carried[max(i, j)] for j in range(n)] for i in range(n)], q)

    def bias(self, q: Value, omega: Value) -> Value:
        """Return C(q, q') + D q' + g(q) (…, n) [N·m]: the torques of a motion without acceleration."""
        rubbing = [d * rate for d, rate in zip(self.damping, self._entries(omega), strict=True)]
        return self.coriolis(q, omega) + self.gravity_torque(q) + _vector(rubbing, q)

    def torque_for(self, q: Value, omega: Value, alpha: Value) -> Value:
        """Return the joints' torques τ = M q'' + C + D q' + g (…, n) [N·m] of a motion (inverse dynamics)."""
        M = self.mass_matrix(q)
        pushed = M @ alpha if is_symbol(M) else (M @ np.asarray(alpha)[..., None])[..., 0]
        return pushed + self.bias(q, omega)

    def points(self, q: Value) -> Value:
        """Return the positions of the hinges and the endpoint (…, n + 1, 2) [m]; the first hinge is the origin."""
        phi = self._angles(q)
        x, y = [0.0 * phi[0]], [0.0 * phi[0]]
        for length, angle in zip(self.length, phi, strict=True):
            x.append(x[-1] + length * cos(angle))
            y.append(y[-1] + length * sin(angle))
        return _matrix([list(point) for point in zip(x, y, strict=True)], q)

    # --- the pieces -------------------------------------------------------------------------------------------------

    @cached_property
    def _moments(self) -> Array:
        """Moments s (n,) [kg·m]."""
        length, m, a = (np.array(field) for field in (self.length, self.mass, self.centre))
        return np.asarray(m * a + length * self._carried_mass)

    @cached_property
    def _coupling(self) -> Array:
        """Coefficients c (n, n) [kg·m²], symmetric."""
        length, m, a, inertia = (np.array(field) for field in (self.length, self.mass, self.centre, self.inertia))
        c = np.triu(np.outer(length, self._moments), 1)
        return np.asarray(c + c.T + np.diag(inertia + m * a**2 + length**2 * self._carried_mass))

    @property
    def _carried_mass(self) -> Array:
        """Mass that hangs on the end of every link (n,) [kg]."""
        return np.append(np.cumsum(self.mass[::-1])[-2::-1], 0.0)

    def _angles(self, q: Value) -> list[Value]:
        """Return φ_i, or φ_i' of velocities: the sums of `q` up to each link."""
        own = [s * angle for s, angle in zip(self.sense, self._entries(q), strict=True)]
        return [_sum(own[: i + 1]) for i in range(self.n)]

    def _carried(self, of_links: list[Value]) -> list[Value]:
        """Return the sums at each joint of the terms of all links from its own on."""
        return [s * _sum(of_links[i:]) for i, s in enumerate(self.sense)]

    def _entries(self, q: Value) -> list[Value]:
        """Return the entries of `q`."""
        q = q if is_symbol(q) else np.asarray(q, float)
        size = q.shape[0] if is_symbol(q) else q.shape[-1] if q.ndim else 0
        if size != self.n:
            raise InvalidInput(f"q has the shape {q.shape}; expected (…, {self.n}), the angles of n = {self.n} links")
        return [q[i] if is_symbol(q) else q[..., i] for i in range(self.n)]


def check_bodies(bodies: Any, mechanism: Mechanism) -> None:
    """Raise `InvalidInput` unless the bodies have the joints of the mechanism; on `Sites`, `Bodies` have its links."""
    n, routes = mechanism.n, mechanism.routes
    if bodies.n != n:
        raise InvalidInput(f"Arm: bodies of {bodies.n} links for a mechanism with n = {n} joints")
    if not (isinstance(bodies, Bodies) and isinstance(routes, Sites)):
        return
    q = np.arange(1.0, n + 1) / n  # a generic posture
    own, led = Linkage(bodies.links).frames(q)[:n], routes.linkage.frames(q)[:n]
    for i, (mine, other) in enumerate(zip(own, led, strict=True)):
        apart = (other.origin - led[0].origin - mine.origin)[:2]  # the chain may begin anywhere
        if not np.allclose(mine.rotation, other.rotation, atol=_SAME) or np.abs(apart).max() > _SAME:
            link = bodies.links[i]
            origin = f"origin = {checks.brief(link.origin)}, " if i else ""
            raise InvalidInput(
                f"Arm: link {i} of the routes (counted from 0) is not that of the bodies, which lie along x at "
                f"q = 0: expected parent = {link.parent}, {origin}axis = {checks.brief(link.axis)}, zero = 0 and no "
                "orientation"
            )


def _row(value: ArrayLike) -> list[float]:
    row: list[float] = np.asarray(value, float).tolist()
    return row


def _sum(terms: Iterable[Value]) -> Value:
    total, *rest = terms if isinstance(terms, list) else list(terms) or [0.0]
    for term in rest:
        total = total + term
    return total


def _vector(entries: list[Value], like: Value) -> Value:
    if is_symbol(like):
        import casadi

        return casadi.vertcat(*entries)
    made = np.empty((*np.shape(like)[:-1], len(entries)))
    for i, entry in enumerate(entries):
        made[..., i] = entry
    return made


def _matrix(rows: list[list[Value]], like: Value) -> Value:
    if is_symbol(like):
        import casadi

        return casadi.vertcat(*(casadi.horzcat(*row) for row in rows))
    return np.stack([_vector(row, like) for row in rows], axis=-2)


def arm26_bodies() -> Bodies:
    """Return the bodies of `allocator.mechanism.machines.arm26`: two rods in a horizontal plane.

    Lengths are those of a human upper arm and forearm with the hand at the grip (0.31 m and 0.34 m: R. Shadmehr and F.
    A. Mussa-Ivaldi, "Adaptive representation of dynamics during learning of a motor task", J. Neurosci. 14, 1994, give
    0.33 and 0.34), masses those of a robot's light aluminium links (1.93 and 1.52 kg there). The damping gives the
    posture q = 0 at K = diag(10, 10) N·m/rad a damping ratio of about 0.1 to 0.3. In a horizontal plane, where such
    arms are studied, gravity has no moment.
    """
    return Bodies.rods((0.31, 0.34), (1.2, 0.8), 0.25)


def arm48_bodies() -> Bodies:
    """Return the bodies of `allocator.mechanism.machines.arm48`: four rods in a vertical plane that hang at q = 0.

    Our choice: 0.85 m and 1.7 kg in all, similar to a lightweight cable-driven arm (D. Büchler, H. Ott and J. Peters,
    ICRA 2016), but in one plane; each link is lighter than the one before. At 90° gravity needs 6 N·m of the 9 N·m
    available from the base's muscles.
    """
    return Bodies.rods((0.25, 0.25, 0.2, 0.15), (0.6, 0.5, 0.35, 0.25), (0.3, 0.2, 0.1, 0.03), (EARTH, 0.0))


def leg37_bodies() -> Bodies:
    """Return the bodies of `allocator.mechanism.machines.leg37`: three rods in a vertical plane that hang at q = 0.

    Lengths of thigh and shank are those of a person of 1.75 m (0.245 and 0.246 of the height: D. A. Winter,
    "Biomechanics and Motor Control of Human Movement", 4th ed. 2009, Fig. 4.1); the masses are our choice for a robot.
    The knee flexes against the sense of hip and ankle. At q = 0 the foot is in line with the shank.
    """
    return Bodies.rods((0.43, 0.43, 0.2), (3.0, 2.0, 0.6), 0.3, (EARTH, 0.0), (1, -1, 1))


BODIES = {"arm26": arm26_bodies, "arm48": arm48_bodies, "leg37": leg37_bodies}
"""The bodies of the ready-made machines, which all move in a plane, by the name of the machine."""
