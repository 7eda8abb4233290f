"""The numbers of a governor's kernel are computed here: the stiff rest, the barrier around it, steps and horizon."""

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import lsq_linear, minimize, root

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.limits import BINDS
from mpc.codegen.python_text import filling
from mpc.governor import kernel
from mpc.governor.model import Dynamics, motion_function, potential_function, statics_function

_POSTURES = 4000  # that are looked at in the range, about
_FREE = 1e6  # [rad] of a joint without end stops
_INNER = np.deg2rad(0.5)  # by which the integration may err
_RESOLUTION = 0.25  # of a step in times of the fastest motion: an error of some 0.3 % of its frequency
_DAMPING = 0.3  # ratio that the backup gives the least damped motion at the rest
_MOST_SAMPLES = 1000  # of a rollout


class Limits(NamedTuple):
    """The `Limits` are what a governor is asked to keep, beside the mechanism's own; SI units."""

    dt: float
    slew: float
    lag: Array  # (m)
    margin: float
    min_force: float
    max_energy: float | None


class Made(NamedTuple):
    """What is `Made` of a governor: the kernel's numbers, and the formulas as CasADi functions and as Python."""

    rules: kernel.Rules
    functions: tuple[Any, Any]  # motion, potential
    text: str


def make(dynamics: Dynamics, limits: Limits) -> Made:
    """Compute the numbers and the formulas.

    Raises `InvalidInput` for muscles that are not affine, routes without formulas, and where no pressures of the supply
    keep the joints in their range against gravity and load.
    """
    mechanism = dynamics.mechanism
    most = np.array([min(mechanism.pressure_limits[1], muscle.max_pressure) for muscle in mechanism.muscles])
    ranged = mechanism.angle_limits is not None
    rest = _Rest.of(dynamics, limits, most) if ranged else _Rest.nowhere(mechanism.n, most)
    functions = motion_function(dynamics, rest.q), potential_function(dynamics, rest.q, rest.P)
    motion, potential = (filling(f.name(), f) for f in functions)
    lo, hi = mechanism.pressure_limits
    numbers = np.zeros(12)
    numbers[[kernel.LEAST, kernel.MIN_FORCE, kernel.SLEW]] = lo, limits.min_force, limits.slew
    numbers[[kernel.REACH, kernel.NEAR]] = limits.slew * limits.dt, BINDS * (hi - lo)
    numbers[kernel.REACTION] = float(limits.lag.max()) + limits.dt
    numbers[kernel.ENERGY] = np.inf if limits.max_energy is None else limits.max_energy
    numbers[[kernel.LOWEST, kernel.ROOT, kernel.BRAKE]] = rest.lowest, rest.root, rest.brake
    numbers[[kernel.INNER, kernel.RANGED]] = min(_INNER, 0.05 * float(np.ptp(rest.ends, axis=1).min())), float(ranged)
    steps, counts = _steps(limits, rest, hi - lo)
    with np.errstate(divide="ignore"):
        decay = np.exp(-steps[:, None] / limits.lag)
    rules = kernel.Rules(
        numbers, most, dynamics.load, rest.ends, rest.P, rest.weight, limits.lag, steps, decay, counts,
        motion.c, potential.c,
    )  # fmt: skip
    return Made(rules, functions, f"import math\n\nimport numpy as np\n\n\n{motion.text}\n\n{potential.text}\n\n")


def memory_for(n: int, m: int) -> kernel.Memory:
    """Return the memory for n joints and m muscles."""
    sizes = {"energy": 2, "level": 1, "within": (n, 2)}
    sizes |= dict.fromkeys(("angles", "rates", "guess", "alpha", "later"), n)
    return kernel.Memory(*(np.zeros(sizes.get(name, m)) for name in kernel.Memory._fields))


class _Rest(NamedTuple):
    """The rest is where the backup goes to."""

    ends: Array  # (n, 2) [rad]
    q: Array  # (n) [rad]
    P: Array  # (m) [Pa]
    weight: Array  # (m) [√J/(Pa·s)]
    lowest: float  # energy in the range [J]
    root: float  # of the barrier [√J]
    brake: float  # [Pa·s/m]
    rates: tuple[float, float]  # of the slowest and the fastest motion [rad/s]

    @classmethod
    def of(cls, dynamics: Dynamics, limits: Limits, most: Array) -> "_Rest":
        """Find it: in the middle of the range, with pressures in the middle of those that are taut in all of it."""
        mechanism, statics = dynamics.mechanism, statics_function(dynamics)
        ends = np.array(mechanism.angle_limits) + limits.margin * np.array([1.0, -1.0])
        grid = _grid(ends)
        _, gain, stiff, M, _, A, B = _at(statics, grid, most)
        least = np.clip(((limits.min_force - B) / A).max(axis=0)[:, 0], mechanism.pressure_limits[0], most)
        P = _held(statics, ends.mean(axis=1), least, most)
        found = root(lambda q: np.array(statics(q, P)[0]).ravel(), ends.mean(axis=1))
        q = found.x
        lowest, barrier = _levels(dynamics, statics, ends, grid, q, P)
        _, moved, K, mass, slope, *_ = (np.array(value) for value in statics(q, P))
        squares, modes = eigh(K, mass)
        if not (found.success and barrier > lowest and squares[0] > 0):
            raise InvalidInput(
                "PressureGovernor: no pressures of the supply hold the joints in their range against gravity and load"
            )
        lost = np.diag(modes.T @ -moved @ slope @ modes)  # of the energy of each motion, by pressures -s
        weight = np.sqrt(np.einsum("gij,gij->gj", gain, np.linalg.solve(M, gain)).max(axis=0) / 2)
        brake = 2 * _DAMPING * float(np.min(np.sqrt(squares) / lost))
        fastest = float(max(eigh(*pair, eigvals_only=True)[-1] for pair in zip(stiff, M, strict=True)))
        return cls(ends, q, P, weight, lowest, (barrier - lowest) ** 0.5, brake, (squares[0] ** 0.5, fastest**0.5))

    @classmethod
    def nowhere(cls, n: int, most: Array) -> "_Rest":
        """Return what stands for it where there is no range."""
        return cls(np.tile([-_FREE, _FREE], (n, 1)), np.zeros(n), most, 0 * most, 0.0, 0.0, 0.0, (1.0, 1.0))


def _grid(ends: Array) -> Array:
    """Return postures (N, n) all over the range."""
    per_joint = max(int(_POSTURES ** (1 / len(ends))) // 2 * 2 + 1, 3)
    axes = [np.linspace(low, high, min(per_joint, 201)) for low, high in ends]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(ends))


def _at(statics: Any, grid: Array, P: Array) -> list[Array]:
    """Return all that `statics` says at postures (N, n): arrays (N, …, …)."""
    made = statics.map(len(grid))(grid.T, np.tile(P[:, None], len(grid)))
    return [np.array(a).reshape(a.shape[0], len(grid), -1).transpose(1, 0, 2) for a in made]


def _held(statics: Any, q: Array, least: Array, most: Array) -> Array:
    """Return the pressures (m) nearest to the middle between `least` and `most` that hold the posture `q`."""
    torque, gain, *_ = (np.array(value) for value in statics(q, 0 * most))
    middle, span = (least + most) / 2, np.maximum(most - least, 1.0)
    rows = np.vstack([1e4 * gain * span, np.eye(len(most))])
    found = lsq_linear(rows, np.concatenate([-1e4 * (torque[:, 0] + gain @ middle), 0 * most]), (-0.5, 0.5))
    return np.asarray(middle + span * found.x)


def _levels(dynamics: Dynamics, statics: Any, ends: Array, grid: Array, q: Array, P: Array) -> tuple[float, float]:
    """Return the least energy [J] in the range and the least at its ends: on the grid, and from there downhill."""
    potential = potential_function(dynamics, q, P)
    levels = np.array(potential.map(len(grid))(grid.T))[0]
    found = [float(levels.min())]

    def downhill(start: Array, bounds: Array) -> float:
        def both(at: Array) -> tuple[float, Array]:
            return float(potential(at)), -np.array(statics(at, P)[0])[:, 0] - dynamics.load * np.sign(at - q)

        return float(minimize(both, start, jac=True, bounds=bounds).fun)

    found.append(downhill(q, ends))
    at_ends = []
    for i, pair in enumerate(ends):
        for end in pair:
            face = np.flatnonzero(grid[:, i] == end)
            bounds = ends.copy()
            bounds[i] = end
            for k in face[np.argsort(levels[face])[:2]]:
                at_ends += [float(levels[k]), downhill(grid[k], bounds)]
    return min(found), min(at_ends)


def _steps(limits: Limits, rest: _Rest, span: float) -> tuple[Array, Any]:
    """Return the steps (2) [s] of the first sample and of later ones, and the kernel's counts (4)."""
    slowest, fastest = rest.rates
    longest = _RESOLUTION / fastest
    stretch = max(int(longest / limits.dt), 1)
    first, later = (max(int(np.ceil(k * limits.dt / longest)), 1) for k in (1, stretch))
    horizon = span / limits.slew + 5 * float(limits.lag.max()) + 4 * np.pi / slowest
    samples = min(int(np.ceil(horizon / (stretch * limits.dt))), _MOST_SAMPLES)
    steps = np.array([limits.dt / first, stretch * limits.dt / later])
    return steps, np.array([first, later, samples, stretch])


__all__ = ["Limits", "Made", "make", "memory_for"]
