"""Numbers of a governor's kernel: the stiff rest, the barriers around it, steps and horizon."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import lsq_linear, minimize, root

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.joint.limits import BINDS
from allocator.lazy import Function
from mpc.codegen.text import IMPORTS, filling
from mpc.governor import kernel
from mpc.governor.model import Corners, Dynamics, corners, motion_function, potential_function, statics_function

_POSTURES = 4000  # approximate number in the range
_FREE = 1e6  # [rad] of a joint without end stops
_INNER = np.deg2rad(0.5)  # allowed error of the integration
_RESOLUTION = 0.25  # step times the rate of the fastest motion: an error of about 0.3 % of its frequency
_DAMPING = 0.3  # damping ratio of the least damped motion at the rest, by the backup
_MOST_SAMPLES = 1000  # per rollout
_BALANCED = 1e-9  # torque at rest relative to the greatest of a muscle
_NO_REST = (
    "PressureGovernor: no pressures of the supply hold the joints in their range against gravity and load, for "
    "all that the intervals leave open"
)


class Limits(NamedTuple):
    """Limits of a governor beyond those of the mechanism; SI units."""

    dt: float
    slew: float
    lag: Array  # (2, m) least and greatest
    margin: float
    min_force: float
    max_energy: float | None


class Made(NamedTuple):
    """Numbers of a governor's kernel, and its formulas as CasADi functions and as Python."""

    rules: kernel.Rules
    functions: tuple["Function", "Function"]  # motion, potential
    text: str


def make(dynamics: Dynamics, limits: Limits) -> Made:
    """Compute the numbers and the formulas.

    Raises `InvalidInput` for muscles that are not affine, routes without formulas, and if no pressures of the supply
    keep the joints in their range against gravity and load.
    """
    mechanism = dynamics.mechanism
    most = np.array([min(mechanism.pressure_limits[1], muscle.max_pressure) for muscle in mechanism.muscles])
    ranged = mechanism.angle_limits is not None
    middle = np.zeros(mechanism.n) if mechanism.angle_limits is None else np.mean(mechanism.angle_limits, axis=1)
    cases = corners(dynamics, limits.lag, middle)
    rest = _Rest.of(dynamics, limits, most, cases) if ranged else _Rest.nowhere(mechanism.n, most, cases)
    functions = motion_function(dynamics, rest.q), potential_function(dynamics, rest.q, rest.P)
    motion, potential = (filling(f.name(), f) for f in functions)
    steps, counts = _steps(limits, rest, mechanism.pressure_limits[1] - mechanism.pressure_limits[0])
    with np.errstate(divide="ignore"):
        decay = np.exp(-steps[None, :, None] / cases.lag[:, None, :]).reshape(-1, mechanism.m)
    rules = kernel.Rules(
        _numbers(dynamics, limits, rest), most, dynamics.load, rest.ends, rest.P, dynamics.strength,
        dynamics.scenes(cases.values), rest.barrier, rest.weight, rest.volume, cases.lag, steps, decay,
        np.append(counts, len(cases.lag)), motion.c, potential.c,
    )  # fmt: skip
    return Made(rules, functions, f"{IMPORTS}{motion.text}\n\n{potential.text}\n\n")


def _numbers(dynamics: Dynamics, limits: Limits, rest: "_Rest") -> Array:
    """Return `kernel.Rules.numbers`."""
    mechanism = dynamics.mechanism
    lo, hi = mechanism.pressure_limits
    numbers = np.zeros(11)
    weakest = float(dynamics.strength[0 if limits.min_force > 0 else 1].min())
    numbers[[kernel.LEAST, kernel.MIN_FORCE, kernel.SLEW]] = lo, limits.min_force / weakest, limits.slew
    numbers[[kernel.REACH, kernel.NEAR]] = limits.slew * limits.dt, BINDS * (hi - lo)
    numbers[kernel.REACTION] = float(limits.lag.max()) + limits.dt
    numbers[kernel.ENERGY] = np.inf if limits.max_energy is None else limits.max_energy
    numbers[kernel.BRAKE] = rest.brake
    numbers[kernel.INNER] = min(_INNER, 0.05 * float(np.ptp(rest.ends, axis=1).min()))
    numbers[kernel.ATMOSPHERE] = 0.0 if dynamics.gas is None else dynamics.gas.atmosphere
    numbers[kernel.RANGED] = float(mechanism.angle_limits is not None)
    return numbers


def memory_for(rules: kernel.Rules) -> kernel.Memory:
    """Return the memory of a governor with these rules."""
    n, m = rules.load.size, rules.most.size
    sizes = {"energy": 2, "level": 1, "within": (n, 2), "scene": rules.scenes.shape[1]}
    sizes |= dict.fromkeys(("angles", "rates", "guess", "alpha", "later"), n)
    return kernel.Memory(*(np.zeros(sizes.get(name, m)) for name in kernel.Memory._fields))


class _Rest(NamedTuple):
    """Final posture and pressures of the backup, and the barriers around it in all scenes."""

    ends: Array  # (n, 2) [rad]
    q: Array  # (n) [rad]
    P: Array  # (m) [Pa]
    barrier: Array  # (s, 2) energy in the range [J] and root of the barrier [√J]
    weight: Array  # (s, m) [√J/(Pa·s)]
    volume: Array  # (s, m) greatest V/κ of the gas [m³]
    brake: float  # [Pa·s/m]
    rates: tuple[float, float]  # of the slowest and the fastest motion [rad/s]

    @classmethod
    def of(cls, dynamics: Dynamics, limits: Limits, most: Array, cases: Corners) -> "_Rest":
        """Find the rest in the middle of the range, with pressures in the middle of those that are taut throughout."""
        mechanism, statics, middle = dynamics.mechanism, statics_function(dynamics), dynamics.middle
        ends = np.array(mechanism.angle_limits) + limits.margin * np.array([1.0, -1.0])
        grid = _grid(ends)
        A, B = _at(statics, grid, most, middle)[5:7]
        taut = ((limits.min_force / dynamics.strength[0][:, None] - B) / A).max(axis=0)[:, 0]
        least = np.clip(taut, mechanism.pressure_limits[0], most)
        P = _held(lambda q, P: statics(q, P, middle), ends.mean(axis=1), least, most)
        q, balanced = _settled(statics, ends.mean(axis=1), P, middle)
        _, moved, K, mass, slope, *_ = (np.array(value) for value in statics(q, P, middle))
        squares, modes = eigh(K, mass)
        if not (balanced and squares[0] > 0):
            raise InvalidInput(_NO_REST)
        lost = np.diag(modes.T @ -moved @ slope @ modes)  # energy that pressures -s take from each motion
        brake = 2 * _DAMPING * float(np.min(np.sqrt(squares) / lost))
        each = _barriers(dynamics, ends, grid, q, P, most, cases)
        rates = min(barrier.slowest for barrier in each), max(barrier.fastest for barrier in each)
        levels = np.array([[barrier.lowest, barrier.root] for barrier in each])
        weight, volume = (np.array(rows) for rows in zip(*((one.weight, one.volume) for one in each), strict=True))
        return cls(ends, q, P, levels, weight, volume, brake, rates)

    @classmethod
    def nowhere(cls, n: int, most: Array, cases: Corners) -> "_Rest":
        """Return a placeholder for mechanisms without a range."""
        s = len(cases.lag)
        ends = np.tile([-_FREE, _FREE], (n, 1))
        none = np.zeros((s, most.size))
        return cls(ends, np.zeros(n), most, np.zeros((s, 2)), none, none, 0.0, (1.0, 1.0))


class _Barrier(NamedTuple):
    """Energies around the rest in one scene."""

    lowest: float  # energy in the range [J]
    root: float  # of the barrier [√J]
    weight: Array  # (m) [√J/(Pa·s)]
    volume: Array  # (m) greatest V/κ of the gas [m³]
    slowest: float  # motion [rad/s]
    fastest: float  # motion [rad/s]


def _barriers(
    dynamics: Dynamics, ends: Array, grid: Array, q: Array, P: Array, most: Array, cases: Corners
) -> list[_Barrier]:
    """Return the barrier of every scene. Raises `InvalidInput` if a scene has none."""
    statics, potential = statics_function(dynamics), potential_function(dynamics, q, P)
    n, known, found = dynamics.mechanism.n, dict[tuple[float, ...], _Barrier](), []
    for values, scene in zip(cases.values, dynamics.scenes(cases.values), strict=True):
        key = (*values[: -n - 1], values[-1])  # neither damping nor lags change energies
        if key not in known:
            known[key] = _barrier(dynamics, statics, potential, ends, grid, q, P, most, scene)
        found.append(known[key])
    return found


def _barrier(
    dynamics: Dynamics, statics: "Function", potential: "Function", ends: Array, grid: Array, q: Array, P: Array,
    most: Array, scene: Array,
) -> _Barrier:  # fmt: skip
    """Return the barrier of one scene. Raises `InvalidInput`."""
    load, kappa = dynamics.load, 1.0 if dynamics.gas is None else dynamics.gas.kappa
    _, gain, _, M, _, _, _, stiff, V = _at(statics, grid, most, scene)

    def level(at: Array) -> float:
        return float(potential(at, scene))

    def slope(at: Array) -> Array:
        return -np.array(statics(at, P, scene)[0])[:, 0] - load * np.sign(at - q)

    levels = np.array(potential.map(len(grid))(grid.T, np.tile(scene[:, None], len(grid))))[0]
    lowest, barrier = _levels(level, slope, levels, ends, grid, q)
    there, balanced = _settled(statics, q, P, scene)
    _, _, K, mass, *_ = (np.array(value) for value in statics(there, P, scene))
    squares = eigh(K, mass, eigvals_only=True)
    if not (balanced and barrier > lowest and squares[0] > 0):
        raise InvalidInput(_NO_REST)
    weight = np.sqrt(np.einsum("gij,gij->gj", gain, np.linalg.solve(M, gain)).max(axis=0) / 2)
    fastest = float(max(eigh(*pair, eigvals_only=True)[-1] for pair in zip(stiff, M, strict=True)))
    volume = V.max(axis=0)[:, 0] / kappa
    return _Barrier(lowest, (barrier - lowest) ** 0.5, weight, volume, squares[0] ** 0.5, fastest**0.5)


def _grid(ends: Array) -> Array:
    """Return postures (N, n) all over the range."""
    per_joint = max(int(_POSTURES ** (1 / len(ends))) // 2 * 2 + 1, 3)
    axes = [np.linspace(low, high, min(per_joint, 201)) for low, high in ends]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(ends))


def _at(statics: "Function", grid: Array, P: Array, scene: Array) -> list[Array]:
    """Return all outputs of `statics` at postures (N, n): arrays (N, …, …)."""
    made = statics.map(len(grid))(grid.T, *(np.tile(row[:, None], len(grid)) for row in (P, scene)))
    return [np.array(a).reshape(a.shape[0], len(grid), -1).transpose(1, 0, 2) for a in made]


def _held(statics: Callable[[Array, Array], Value], q: Array, least: Array, most: Array) -> Array:
    """Return the pressures (m) nearest to the middle between `least` and `most` that hold the posture `q`."""
    torque, gain, *_ = (np.array(value) for value in statics(q, 0 * most))
    middle, span = (least + most) / 2, np.maximum(most - least, 1.0)
    rows = np.vstack([1e4 * gain * span, np.eye(len(most))])
    found = lsq_linear(rows, np.concatenate([-1e4 * (torque[:, 0] + gain @ middle), 0 * most]), (-0.5, 0.5))
    return np.asarray(middle + span * found.x)


def _settled(statics: "Function", q: Array, P: Array, scene: Array) -> tuple[Array, bool]:
    """Return the posture (n) near `q` in which the torques balance, and whether they do.

    The torques decide, because SciPy reports a failure if the search begins at the solution.
    """
    found = root(lambda q: np.array(statics(q, P, scene)[0]).ravel(), q)
    size = float(np.abs(np.array(statics(found.x, P, scene)[1]) * P).max())
    return found.x, bool(np.abs(found.fun).max() <= _BALANCED * size)


def _levels(
    level: Callable[[Array], float], slope: Callable[[Array], Array], levels: Array, ends: Array, grid: Array, q: Array
) -> tuple[float, float]:
    """Return the least energy [J] in the range and the least at its ends: on the grid, and from there downhill."""
    found = [float(levels.min())]

    def downhill(start: Array, bounds: Array) -> float:
        return float(minimize(lambda at: (level(at), slope(at)), start, jac=True, bounds=bounds).fun)

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


def _steps(limits: Limits, rest: _Rest, span: float) -> tuple[Array, NDArray[np.int64]]:
    """Return the steps (2) [s] of the first sample and of later ones, and the kernel's counts (4)."""
    slowest, fastest = rest.rates
    longest = _RESOLUTION / fastest
    stretch = max(int(longest / limits.dt), 1)
    first, later = (max(int(np.ceil(k * limits.dt / longest)), 1) for k in (1, stretch))
    horizon = span / limits.slew + 5 * float(limits.lag.max()) + 4 * np.pi / slowest
    samples = min(int(np.ceil(horizon / (stretch * limits.dt))), _MOST_SAMPLES)
    steps = np.array([limits.dt / first, stretch * limits.dt / later])
    return steps, np.array([first, later, samples, stretch])
