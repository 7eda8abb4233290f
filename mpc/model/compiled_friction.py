"""Memory and prediction of known friction, as of `Friction` and `MaxwellSlip`: T_f = strength Σ k_i z_i."""

from collections.abc import Callable, Sequence
from math import copysign, exp, isinf
from typing import Annotated, NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined_flat
from mpc.codegen.views import flat, in_python, viewer
from mpc.model.compensation import JITTER
from mpc.model.friction.contact import Hysteresis, Loads
from mpc.model.friction.dahl import WIDTH_AT, Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip

ABSENT, DAHL, SLIP = range(3)
_SPAN = 2 * WIDTH_AT  # [Pa]


class Rubbing(NamedTuple):
    """Numbers of a friction model; those of other models are 0."""

    kind: int
    mu: float  # of `Friction`, as the next two
    coulomb: float  # [N·m]
    presliding: float  # [rad]
    base: float  # of `MaxwellSlip`, as the next one
    elastic: bool
    springs: Annotated[Array, "n"]  # k_i; 1 for Dahl's
    widths: Annotated[Array, "n"]  # [rad]


rubbing_in: Callable[[Array], Rubbing] = viewer(Rubbing)
NO_FRICTION = Rubbing(ABSENT, 0.0, 0.0, 0.0, 0.0, False, np.ones(1), np.zeros(1))


def memory_of(numbers: Array) -> int:
    """Return the size of the friction's memory."""
    return in_python(rubbing_in)(numbers).springs.size


def friction_numbers(friction: Hysteresis) -> Array | None:
    """Return the numbers of `friction`, see `Rubbing`; None for an unsupported model."""
    if type(friction) is Friction:
        kind = ABSENT if friction.absent else DAHL
        dahls = NO_FRICTION._replace(kind=kind, mu=friction.mu, coulomb=friction.coulomb)
        return flat(dahls._replace(presliding=friction.presliding))
    if type(friction) is MaxwellSlip:
        springs, widths = np.array(friction.springs), np.array(friction.widths)
        slip = NO_FRICTION._replace(kind=SLIP, base=friction.base, elastic=bool(friction.elastic))
        return flat(slip._replace(springs=springs, widths=widths))
    return None


def numbers_of_joints(frictions: Sequence[Hysteresis]) -> Array | None:
    """Return the numbers (n, …) of the friction of every joint, with springs without force so that all have as many;
    None if there is an unsupported model.
    """
    known = [numbers for numbers in map(friction_numbers, frictions) if numbers is not None]
    if len(known) < len(frictions):
        return None
    most = max(map(memory_of, known))
    rows = []
    for f in map(in_python(rubbing_in), known):
        springs, widths = np.zeros((2, most))
        springs[: f.springs.size], widths[: f.springs.size] = f.springs, f.widths
        rows.append(flat(f._replace(springs=springs, widths=widths)))
    return np.array(rows)


@inlined_flat
def strength(f: Rubbing, pressed: Loads) -> float:
    """Return the factor of Σ k_i z_i in the friction torque [N·m]."""
    if f.kind != SLIP:
        return float(f.mu * pressed.pulled + f.coulomb)
    return float(pressed.stiffness) if f.elastic else 1.0


@inlined_flat
def dahl(z: float, motion: float, presliding: float) -> float:
    """Return z after turning by `motion` [rad], see `allocator.joint.hysteresis.dahl`."""
    s = copysign(1.0, motion)
    return s - (s - z) * exp(-abs(motion) / presliding)


@inlined_flat
def width_of(f: Rubbing, i: int, filled: float) -> float:
    """Return the half width ρ_i [rad] of an element of `MaxwellSlip`."""
    return float((f.base + (1 - f.base) * filled / _SPAN) * f.widths[i])


@inlined_flat
def followed(f: Rubbing, theta: float, pressed: Loads, last: float, memory: Array, now: Array) -> float:
    """Set `now` (n,) to the friction's memory at `theta` [rad], from `memory` (n,) at the angle `last`, NaN for none;
    return the origin of its next motion: see `FrictionState.follow`.
    """
    begins = np.isnan(last)
    motion = 0.0 if begins or not abs(theta - last) > JITTER else theta - last
    for i in range(now.size):
        z = memory[i]
        if f.kind == SLIP:
            width = width_of(f, i, pressed.filled)
            if begins:
                z = theta if isinf(width) else 0.0
            now[i] = min(max(z + motion, -width), width)
        else:
            z = 0.0 if begins else z
            now[i] = dahl(z, motion, f.presliding) if motion != 0.0 else z
    return theta if begins or motion != 0.0 else last


@inlined_flat
def less_friction(f: Rubbing, now: Array, back: float, theta: Array, pressed: Loads, d: float, torques: Array) -> None:
    """Set `torques` (M,) [N·m] to `d` minus the friction of the motion along `theta` (M,) [rad] with the first angle
    `back`, from the memory `now` (n,); friction is left out if any of it is not finite.
    """
    n, M, all_finite = now.size, theta.size, True
    for k in range(M):
        torques[k] = 0.0
    for i in range(n):
        z, slips = now[i], f.kind == SLIP
        width = width_of(f, i, pressed.filled) if slips else 0.0
        for k in range(M):
            if k > 0:
                motion = theta[k] - (back if k == 1 else theta[k - 1])
                z = min(max(z + motion, -width), width) if slips else dahl(z, motion, f.presliding)
            torques[k] += f.springs[i] * z
    most = strength(f, pressed)
    for k in range(M):
        torques[k] *= most
        all_finite = all_finite and np.isfinite(torques[k])
    for k in range(M):
        torques[k] = d - torques[k] if all_finite else d
