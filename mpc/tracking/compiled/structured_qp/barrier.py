"""Search for the active bounds of a far QP by a barrier.

If the solution jumps between the bounds of the slew, most of them change from one QP to the next, and an exchange one
by one takes hundreds of steps. A few sweeps of a primal-dual interior point find most of them at once (S. J. Wright,
Primal-Dual Interior-Point Methods, 1997). Its limits are slew and supply, soft rows are left out, and its result is
only a guess of what is active, which the exchange corrects and proves. With a distance t and a multiplier λ for each
bound a·z ≤ b,

    (H + Σ λ/t a aᵀ) Δz = -∇ - Σ (μ/t + λ/t (a·z + t - b)) a,    Δt = b - a·(z + Δz) - t,    Δλ = μ/t - λ - λ/t Δt

The arrays of the items, unused before an exchange, hold t and λ: lines 0 and 1 for the slew, 2 and 3 for the supply.
"""

from allocator.calculus import Array
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.commands import HUGE
from mpc.tracking.compiled.records import Bounded, Errors, Path, Point, Setting
from mpc.tracking.compiled.structured_qp.certificate import adjoint, gradients
from mpc.tracking.compiled.structured_qp.responses import Items
from mpc.tracking.compiled.structured_qp.riccati import Sweep, backward, forward, take_charges
from mpc.tracking.compiled.structured_qp.sizes import FREE, HIGH, LOW, LOWER, NU, NX, NXI, UPPER

TURNS = 20  # sweeps, at most
SIDES = 4  # of a change: below and above its slew and its supply
NEAR = 0.04  # [bar] least distance from a bound at the beginning
SHARE = 0.01  # [bar] products t λ at the beginning, by the steepest gradient
CENTRED = 0.1  # of these products from one turn to the next
KEPT = 0.99  # of the way to a bound, at most
ENOUGH = 1e-3  # [bar²] product t λ by the curvature of a change: the active bounds are known
HELD = 10.0  # λ/t of an active bound by this curvature, at least


@inlined
def guessed(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, at: Point, sweep: Sweep, r: Array, items: Items
) -> None:  # fmt: skip
    """Set the held changes of the sweep to those that the barrier finds, and the point to its last one."""
    product = placed(path, errors, setting, bounded, at, sweep, items)
    for _ in range(TURNS):
        if product < ENOUGH * setting.curvature:
            break
        gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
        take_charges(setting.cost, sweep)
        weigh(bounded, CENTRED * product, at, sweep, items)
        backward(path, setting.cost, bounded, at, sweep)
        forward(path, sweep, at, r)
        product = moved(bounded, CENTRED * product, at, sweep, items)
    take_charges(setting.cost, sweep)
    hold_active(setting, sweep, items)


@inlined
def placed(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, at: Point, sweep: Sweep, items: Items
) -> float:
    """Set the point to the origin, and its distances and multipliers; return the mean of their products."""
    at.xi[:], at.v[:] = 0.0, 0.0
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    adjoint(path, sweep.gx, sweep.gv, sweep.g)
    steepest = 0.0
    for k in range(at.v.shape[0]):
        for i in range(NU):
            steepest = max(steepest, abs(sweep.g[k, i]))
            for side in range(SIDES):
                items.z[side, k, i] = max(distance(bounded, at, side, k, i), NEAR)
    for k in range(at.v.shape[0]):
        for i in range(NU):
            for side in range(SIDES):
                items.r[side, k, i] = SHARE * steepest / items.z[side, k, i]
    return SHARE * steepest


@inlined_flat
def distance(bounded: Bounded, at: Point, side: int, k: int, i: int) -> float:
    """Return the distance of a change from one of its bounds; negative beyond it."""
    v, w = at.v[k, i], at.xi[k + 1, NX + i]
    if side == 0:
        return float(v - bounded.lower[k, i])
    if side == 1:
        return float(bounded.upper[k, i] - v)
    if side == 2:
        return float(w - bounded.low[k, i])
    return float(bounded.high[k, i] - w)


@inlined_flat
def weigh(bounded: Bounded, product: float, at: Point, sweep: Sweep, items: Items) -> None:
    """Add the barrier's curvature to the charges of the sweep, and its pushes to the gradients; release all changes."""
    for k in range(at.v.shape[0]):
        for i in range(NU):
            sweep.held[k, i] = FREE if bounded.lower[k, i] < bounded.upper[k, i] else LOWER
            for side in range(SIDES if sweep.held[k, i] == FREE else 0):
                t, multiplier = items.z[side, k, i], items.r[side, k, i]
                weight = multiplier / t
                push = product / t + weight * (t - distance(bounded, at, side, k, i))
                push = -push if side == 0 or side == 2 else push
                if side < 2:
                    sweep.change[k, i] += weight
                    sweep.gv[k, i] += push
                else:
                    sweep.e[k, i] += weight
                    sweep.gx[k + 1, NX + i] += push


@inlined_flat
def moved(bounded: Bounded, product: float, at: Point, sweep: Sweep, items: Items) -> float:
    """Shorten the step to keep distances and multipliers positive, and return the mean of their products then."""
    t, multiplier, whole, dual, total, number = items.z, items.r, 1.0 / KEPT, 1.0 / KEPT, 0.0, 0
    for k in range(at.v.shape[0]):
        for i in range(NU):
            for side in range(SIDES if sweep.held[k, i] == FREE else 0):
                farther, more = changes(bounded, product, at, items, side, k, i)
                whole = min(whole, -t[side, k, i] / farther if farther < 0.0 else HUGE)
                dual = min(dual, -multiplier[side, k, i] / more if more < 0.0 else HUGE)
    whole, dual = KEPT * whole, KEPT * dual
    for k in range(at.v.shape[0]):
        for i in range(NU):
            for side in range(SIDES if sweep.held[k, i] == FREE else 0):
                farther, more = changes(bounded, product, at, items, side, k, i)
                t[side, k, i] += whole * farther
                multiplier[side, k, i] += dual * more
                total += t[side, k, i] * multiplier[side, k, i]
                number += 1
    for k in range(at.v.shape[0]):
        for i in range(NU):
            at.v[k, i] -= (1.0 - whole) * sweep.v[k, i]
        for i in range(NXI):
            at.xi[k + 1, i] -= (1.0 - whole) * sweep.xi[k + 1, i]
    return total / max(number, 1)


@inlined_flat
def changes(
    bounded: Bounded, product: float, at: Point, items: Items, side: int, k: int, i: int
) -> tuple[float, float]:  # fmt: skip
    """Return Δt and Δλ of a bound for the whole step."""
    t, multiplier = items.z[side, k, i], items.r[side, k, i]
    farther = distance(bounded, at, side, k, i) - t
    return farther, (product - multiplier * farther) / t - multiplier


@inlined_flat
def hold_active(setting: Setting, sweep: Sweep, items: Items) -> None:
    """Hold each change at the bound with the greatest λ/t, if that counts as active."""
    for k in range(sweep.v.shape[0]):
        for i in range(NU):
            most = HELD * setting.curvature
            for side in range(SIDES if sweep.held[k, i] == FREE else 0):
                weight = items.r[side, k, i] / items.z[side, k, i]
                if weight > most:
                    most = weight
                    sweep.held[k, i] = (LOWER if side == 0 else UPPER) if side < 2 else (LOW if side == 2 else HIGH)
