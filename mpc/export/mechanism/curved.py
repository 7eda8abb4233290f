"""Muscles that are not affine in the pressure are written here for C: their laws by CasADi, and where these turn."""

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.one_muscle import OneMuscle
from allocator.mechanism import Mechanism
from allocator.mechanism.relaxation.curves import Curve, rises
from allocator.muscles import Muscle
from allocator.muscles.base import SEARCH_CEILING
from mpc.export import text
from mpc.export.joint import Numbers
from mpc.model.lengths import symbolic_lengths

_CONTRACTIONS = 61  # at which the curves are looked at
_LEAST_SAMPLES, _MOST_SAMPLES = 9, 129  # pressures between which C looks for a turn
_FINER = 3  # samples between two turns, and between a turn and the end
_DEPTH = 64  # nodes that wait on the stack
NODES, GAP = 500, 1e-3  # by default, as Python has them
ROUNDS = 400  # of guesses that the kernel may make; a node that takes more has its parent's bound

_ROUNDING: dict[str, tuple[float, float, str]] = {  # in double and in single precision
    "SETTLED": (1e-13, 3e-7, "of the supply: a smaller step ends a descent"),
    "SMALLEST": (1e-9, 1e-5, "trust region, of the supply"),
    "CHANGES": (1e-13, 1e-6, "of a cost: a smaller change is none"),
    "ALIKE": (1e-6, 1e-4, "of a cost: a smaller change does not matter while the steps become smaller"),
    "NOTHING": (1e-10, 1e-6, "of the scale of a level: a smaller error is none"),
    "ALIGNED": (1e-6, 1e-5, "of the supply: a smaller distance from the reference is none"),
    "AT_BOUND": (1e-12, 1e-6, "of the supply: a step that ends this near to a bound ends on it"),
    "STRAIGHTNESS": (1e-10, 1e-4, "of its terms: a smaller k'' F' - k' F'' is rounding"),
    "BESIDE": (1e-10, 1e-6, "of the interval: how far beside a kink its two sides are looked at"),
    "WIDER": (1e-9, 1e-5, "of the slopes, by which what encloses a curve is wider than they say"),
    "APART": (1e-10, 1e-5, "of the equalities' size: a smaller distance from them is rounding"),
    "TIGHT": (1e-9, 1e-5, "of what the polygons give: a lower cost of the earlier level is rounding"),
    "HOLDS": (1e-6, 1e-3, "of the same: a muscle that costs more anywhere else stays where it is"),
    "AS_GOOD": (1e-9, 1e-4, "weighted: an earlier level's errors that differ by less are alike"),
}


def curved_functions(mechanism: Mechanism) -> list[tuple[Any, str]]:
    """Return the CasADi functions of the routes and of each different muscle, and what each computes.

    Raises `InvalidInput` for routes without formulas.
    """
    import casadi as ca

    q = ca.SX.sym("q", mechanism.n)
    length, rest = symbolic_lengths(mechanism.routes, q), mechanism.routes.rest_length
    arm, (rows, columns) = -ca.jacobian(length, q), mechanism.upper_triangle
    bends = [ca.hessian(length[j], q)[0] for j in range(mechanism.m)]
    entries = ca.vertcat(*(H[i, c] for H in bends for i, c in zip(rows.tolist(), columns.tolist(), strict=True)))
    eps = ca.vertcat(*((L - length[j]) / L for j, L in enumerate(rest)))
    made = list(map(ca.densify, ca.cse([eps, ca.vec(arm.T), entries])))
    routes = ca.Function("routes", [q], made, ["q"], ["contraction", "arm", "bend"])
    functions = [(routes, "q [rad] to contractions, arms r (m, n) [m] and bends H (m, upper triangles) [m/rad]")]
    for index, (muscle, L) in enumerate(_different(mechanism)):
        functions += _laws(index, muscle, L)
    return functions


def _laws(index: int, muscle: Any, L: float) -> list[tuple[Any, str]]:
    """Return the two functions of a muscle."""
    import casadi as ca

    P, eps = ca.SX.sym("P"), ca.SX.sym("eps")
    F, gain = ca.SX(muscle.law(P, eps)), ca.SX(muscle.gain(P, eps))
    k, own_gain = -ca.SX(muscle.slope(P, eps)) / L, -ca.SX(muscle.gain_slope(P, eps)) / L
    second = ca.gradient(gain, P), ca.gradient(own_gain, P)

    def function(name: str, values: list[Any]) -> Any:
        given = ca.densify(ca.cse(ca.vertcat(*values)))
        return ca.Function(f"{name}_{index}", [P, eps], [given], ["P", "eps"], ["given"])

    kind = type(muscle).__name__
    return [
        (function("force", [F, gain]), f"{kind}: F [N] and its derivative by P"),
        (function("law", [F, k, gain, own_gain, *second]), f"{kind}: F, own stiffness k [N/m], F', k', F'', k''"),
    ]


def _different(mechanism: Mechanism) -> list[tuple[Muscle, float]]:
    """Return the different pairs of muscle and rest length."""
    return list(dict.fromkeys(_pairs(mechanism)))


def curved_numbers(single: bool) -> Numbers:
    """Return what the search takes in the place of equality, by name."""
    rounding: Numbers = {name: (s if single else d, about) for name, (d, s, about) in _ROUNDING.items()}
    return {
        **rounding,
        "GAP": (GAP, "by default of 1 + cost: how far what is missed may be above the least [-]"),
        "MOST_NODES": (NODES, "by default, of the search for a level"),
    }


def curved_sizes(mechanism: Mechanism) -> Numbers:
    """Return the sizes of the memory. Raises `InvalidInput` for a law whose curves C cannot follow."""
    kinks, turns = _breaks(mechanism)
    rows = mechanism.n + mechanism.n * (mechanism.n + 1) // 2
    return {
        "VARIABLES": (2 * mechanism.m, "of the kernel: force and own stiffness of each muscle"),
        "LINES": (rows + 2 * mechanism.m, "of the kernel"),
        "LEVELS": (3, "of the kernel"),
        "KINKS": (max(1, kinks), "of a law, at most"),
        "BREAKS": (kinks + turns + 2, "of a curve, at most"),
        "DEPTH": (_DEPTH, "nodes that wait to be looked at"),
    }


def curved_tables(mechanism: Mechanism, single: bool) -> list[str]:
    """Return the definitions of what C looks up for each muscle."""
    different = _different(mechanism)
    index = [different.index(pair) for pair in _pairs(mechanism)]
    most = max(1, *(len(muscle.basis.kinks) for muscle in mechanism.muscles))
    kinks = np.full((mechanism.m, most), 2 * SEARCH_CEILING)  # beyond all pressures: none
    for j, muscle in enumerate(mechanism.muscles):
        kinks[j, : len(muscle.basis.kinks)] = muscle.basis.kinks
    straight = np.array([_straight(mechanism, j) for j in range(mechanism.m)], int)
    samples = np.array([_samples(mechanism, j) for j in range(mechanism.m)], int)
    ceiling = np.array([min(muscle.max_pressure, SEARCH_CEILING) for muscle in mechanism.muscles])
    tables = {"ANT_STRAIGHT": straight, "ANT_SAMPLES": samples, "ANT_KINK": kinks, "ANT_CEILING": ceiling}
    lines = [f"static {text.table(name, values, single)}" for name, values in tables.items()]
    lines.append("typedef void ant_law(const ant_real *P, const ant_real *eps, ant_real *given);")
    for name, function in (("ANT_FORCE", "force"), ("ANT_LAW", "law")):
        listed = ", ".join(f"ant_model_{function}_{i}" for i in index)
        lines.append(f"static ant_law *const {name}[{mechanism.m}] = {{{listed}}};")
    return lines


def _pairs(mechanism: Mechanism) -> list[tuple[Muscle, float]]:
    return list(zip(mechanism.muscles, map(float, mechanism.routes.rest_length), strict=True))


def _straight(mechanism: Mechanism, j: int) -> bool:
    """Return whether muscle `j` is affine in the pressure."""
    return mechanism.muscle_names[j] not in mechanism.not_affine


def _breaks(mechanism: Mechanism) -> tuple[int, int]:
    """Return the most kinks and the most turns of a muscle's curve."""
    kinks = max(len(muscle.basis.kinks) for muscle in mechanism.muscles)
    turns = max(len(turns) for j in range(mechanism.m) for turns in _turns_of(mechanism, j))
    return kinks, turns * (kinks + 1)


def _samples(mechanism: Mechanism, j: int) -> int:
    """Return how many pressures C has to look at between two kinks of muscle `j` to see every turn; 0 without any."""
    every = _turns_of(mechanism, j)
    if not any(turns.size for turns in every):
        return 0
    between = [float(np.diff(turns).min()) for turns in every if turns.size > 1]
    needed = int(np.ceil(_FINER / max(min(between, default=1.0), 1e-9)))
    if needed > _MOST_SAMPLES:
        raise InvalidInput(
            f"{type(mechanism.muscles[j]).__name__} of {mechanism.muscle_names[j]}: its stiffness over its force turns "
            f"twice within 1/{needed // _FINER} of its pressures, more often than the exported search can follow"
        )
    return max(_LEAST_SAMPLES, needed)


def _turns_of(mechanism: Mechanism, j: int) -> tuple[Array, ...]:
    """Return where the slope turns between two kinks, in shares of the way, of all contractions that muscle `j` has."""
    muscle, L = _pairs(mechanism)[j]
    return () if _straight(mechanism, j) else _turns(muscle, L, mechanism.pressure_limits, mechanism.min_contraction)


@cache
def _turns(muscle: Muscle, L: float, supply: tuple[float, float], min_contraction: float) -> tuple[Array, ...]:
    least = max(min_contraction, muscle.min_contraction)
    return tuple(
        turns
        for eps in np.linspace(least, muscle.max_contraction, _CONTRACTIONS).tolist()
        for turns in _turns_at(muscle, L, supply, eps)
    )


def _turns_at(muscle: Muscle, L: float, supply: tuple[float, float], eps: float) -> list[Array]:
    lo, hi = supply[0], min(supply[1], muscle.max_pressure)
    lo = float(np.clip(muscle.pressure(0.0, np.array(eps)), lo, hi))
    if lo >= hi:
        return []
    name = type(muscle).__name__
    side = OneMuscle(muscle, name, L, eps, np.ones(1), np.zeros((1, 1)), vector=True)
    if not rises(side, lo, hi):
        return []  # the exported search looks itself, and says that it has no proof
    curve = Curve.of(side, lo, hi)
    if curve.jumps.size:
        raise InvalidInput(
            f"the stiffness of {name} jumps at {curve.jumps[0]:g} Pa, which the exported search cannot follow"
        )
    ends = [lo, *(kink for kink in muscle.basis.kinks if lo < kink < hi), hi]
    return [(curve.breaks[(curve.breaks > a) & (curve.breaks < b)] - a) / (b - a) for a, b in pairwise(ends)]
