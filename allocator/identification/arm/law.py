"""Motion law of one joint of an arm, with parameters identified from its log.

    v⁺ = S((v + h F)/(1 + h d), h f/(1 + h d)),   q⁺ = q + h v⁺ within the stops,   S(x, y) = sign(x) max(|x| - y, 0)

All terms are divided by the joint's inertia. F is the static surface of both pressures, plus the neighbours' effect,

    F = c(q) + p_a a(q) + a' p_a² + p_b b(q) + b' p_b² + Σ terms        c cubic, a and b quadratic in q

d = d_0 + d_1 (p_a + p_b) is viscous damping and f = f_0 + f_1 (p_a + p_b) + … Coulomb friction: S is its implicit step,
in which a joint stays still until the forces exceed f. The optional terms:

    coupling   Σ_i q_i (k_i + k'_i q) over the other joints i     gravity, and muscles that span two joints
    speeds     Σ_i k_i v_i                                        their gyroscopic and viscous torques
    inertia    Σ_i k_i v'_i                                       their accelerations
    tendons    f grows with the other muscles' pressures          those that are led through this joint
    bearing    f is quadratic in q
    curved     F has p_a² q, p_b² q, p_a p_b, p_a³, p_b³          saturation of muscles
    stops      the angle stays within two ends, found from the log
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.identification.arm.episodes import Windows

TERMS = ("stops", "coupling", "speeds", "inertia", "tendons", "bearing", "curved")
_LEAST_FRICTION = 0.05  # [rad/s²]
_FASTEST = 20.0  # [rad/s]
_LEAST_TURN, _MOST_TURN = -3.0, 3.0  # [rad]


class Parameter(NamedTuple):
    """Parameter of the law: the start of its search, and a usual distance from it."""

    name: str
    start: float
    size: float


class Surroundings(NamedTuple):
    """The rest of the arm in one sample, each (batch, w) or (w,)."""

    q: tuple[Array, ...]  # other joints [rad]
    v: tuple[Array, ...]  # [rad/s]
    acceleration: tuple[Array, ...]  # [rad/s²]
    p: tuple[Array, ...]  # other muscles


@dataclass(frozen=True)
class JointLaw:
    """Names and order of the parameters of one joint in an arm of m joints, in rad, s and pressures over `full`."""

    joint: int
    pair: tuple[int, int]  # muscles that raise and lower the angle
    joints: int  # m
    terms: tuple[str, ...] = ()
    ends: tuple[float, float] = (_LEAST_TURN, _MOST_TURN)  # first guess of the stops [rad]

    @property
    def others(self) -> tuple[int, ...]:
        """Other joints."""
        return tuple(i for i in range(self.joints) if i != self.joint)

    @property
    def other_muscles(self) -> tuple[int, ...]:
        """Muscles of other joints."""
        return tuple(i for i in range(2 * self.joints) if i not in self.pair)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters in the order of x."""
        surface = [Parameter(f"c{i}", start, 50.0) for i, start in enumerate((0.0, -30.0, 0.0, 0.0))]
        for muscle, start in (("a", 40.0), ("b", -40.0)):
            surface += [Parameter(f"{muscle}{i}", start if i == 0 else 0.0, 50.0) for i in range(3)]
            surface.append(Parameter(f"{muscle}'", 0.0, 50.0))
        friction = [
            Parameter(name, start, 10.0) for name, start in (("d0", 8.0), ("d1", 0.0), ("f0", 3.0), ("f1", 1.0))
        ]
        return (*surface, *friction, *(p for term in self.terms for p in self._of_term(term)))

    def _of_term(self, term: str) -> list[Parameter]:
        neighbours = range(self.joints - 1)
        match term:
            case "stops":
                return [Parameter("low", self.ends[0], 0.05), Parameter("high", self.ends[1], 0.05)]
            case "coupling":
                return [Parameter(f"k{i}{power}", 0.0, 10.0) for power in (0, 1) for i in neighbours]
            case "speeds":
                return [Parameter(f"s{i}", 0.0, 3.0) for i in neighbours]
            case "inertia":
                return [Parameter(f"m{i}", 0.0, 0.3) for i in neighbours]
            case "tendons":
                return [Parameter(f"t{i}", 0.0, 5.0) for i in range(2 * self.joints - 2)]
            case "bearing":
                return [Parameter("f'", 0.0, 5.0), Parameter("f''", 0.0, 5.0)]
            case "curved":
                return [Parameter(name, 0.0, 50.0) for name in ("a'1", "b'1", "ab", "a''", "b''")]
        raise ValueError(f"unknown term {term!r}: one of {', '.join(TERMS)}")

    def named(self, x: Array) -> dict[str, Array]:
        """Return the parameters x (batch, n) by name, columns (batch, 1)."""
        return {p.name: x[:, i, None] for i, p in enumerate(self.parameters)}

    def step(
        self, x: Mapping[str, Array], q: Array, v: Array, pa: Array, pb: Array, around: Surroundings, h: float
    ) -> tuple[Array, Array]:
        """Return angle [rad] and speed [rad/s] (batch, w) after h [s]."""
        F, f = self._force(x, q, pa, pb, around), self._friction(x, q, pa, pb, around)
        damped = 1 + h * np.maximum(x["d0"] + x["d1"] * (pa + pb), 0.0)
        free = (v + h * F) / damped
        v = np.clip(np.sign(free) * np.maximum(np.abs(free) - h * f / damped, 0.0), -_FASTEST, _FASTEST)
        moved = q + h * v
        low, high = (x["low"], x["high"]) if "stops" in self.terms else (_LEAST_TURN, _MOST_TURN)
        q = np.clip(moved, low, high)
        return q, np.where(q == moved, v, 0.0)

    def _force(self, x: Mapping[str, Array], q: Array, pa: Array, pb: Array, around: Surroundings) -> Array:
        F = x["c0"] + q * (x["c1"] + q * (x["c2"] + q * x["c3"]))
        F = F + pa * (x["a0"] + q * (x["a1"] + q * x["a2"]) + x["a'"] * pa)
        F = F + pb * (x["b0"] + q * (x["b1"] + q * x["b2"]) + x["b'"] * pb)
        if "coupling" in self.terms:
            F = F + sum(angle * (x[f"k{i}0"] + x[f"k{i}1"] * q) for i, angle in enumerate(around.q))
        if "speeds" in self.terms:
            F = F + sum(x[f"s{i}"] * speed for i, speed in enumerate(around.v))
        if "inertia" in self.terms:
            F = F + sum(x[f"m{i}"] * a for i, a in enumerate(around.acceleration))
        if "curved" in self.terms:
            F = F + q * (x["a'1"] * pa * pa + x["b'1"] * pb * pb) + x["ab"] * pa * pb
            F = F + x["a''"] * pa**3 + x["b''"] * pb**3
        return np.asarray(F)

    def _friction(self, x: Mapping[str, Array], q: Array, pa: Array, pb: Array, around: Surroundings) -> Array:
        f = x["f0"] + x["f1"] * (pa + pb)
        if "tendons" in self.terms:
            f = f + sum(x[f"t{i}"] * p for i, p in enumerate(around.p))
        if "bearing" in self.terms:
            f = f + x["f'"] * q + x["f''"] * q * q
        return np.asarray(np.maximum(f, _LEAST_FRICTION))


def run(laws: Mapping[int, tuple[JointLaw, Array]], windows: Windows) -> dict[int, Array]:
    """Return the angles (batch, w, steps) [rad] of joints that run freely; the others are as measured.

    `laws` are the law and the parameters (batch, n) of every joint to run, by number.
    """
    q, v, p, h, _ = windows
    joints = range(q.shape[2])
    named = {j: law.named(x) for j, (law, x) in laws.items()}
    batch = {j: np.zeros((len(x), 1)) for j, (_, x) in laws.items()}
    angle = {j: batch[j] + q[:, 1, j] for j in laws}
    speed = {j: batch[j] + v[:, 1, j] for j in laws}
    before = {j: batch[j] + v[:, 0, j] for j in laws}
    out = {j: np.empty((*angle[j].shape, windows.horizon)) for j in laws}
    for t in range(windows.horizon):
        at = [angle.get(i, q[:, t + 1, i]) for i in joints]
        fast = [speed.get(i, v[:, t + 1, i]) for i in joints]
        turn = [(fast[i] - before.get(i, v[:, t, i])) / h for i in joints]
        before = dict(speed)
        for j, (law, _) in laws.items():
            now = p[:, t + 1]
            near = [tuple(rows[i] for i in law.others) for rows in (at, fast, turn)]
            around = Surroundings(near[0], near[1], near[2], tuple(now[:, i] for i in law.other_muscles))
            pa, pb = now[:, law.pair[0]], now[:, law.pair[1]]
            angle[j], speed[j] = law.step(named[j], at[j], fast[j], pa, pb, around, h)
            out[j][..., t] = angle[j]
    return out
