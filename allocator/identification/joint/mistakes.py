"""Measured equilibria are searched for what is wrong with them before anything is fitted: one sentence each."""

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.identification.joint.samples import JointSamples
from allocator.units import BAR, DEG

_ONE_LEVEL = 0.03  # of the mean co-contraction
_SEEN = 3.0  # standard deviations from which on the deflection by a weight is not chance
_WANTED = 0.05  # relative accuracy of the deflection that a useful weight gives


def check_data(samples: JointSamples, friction: bool) -> None:
    """Refuse slack joints, swapped muscles, one co-contraction only; with `friction` one direction of motion only."""
    if not samples.n:
        reasons = "; ".join(f"{n} with {reason}" for reason, n in samples.dropped.items())
        raise InvalidInput(f"no equilibrium is left in which both muscles can be taut ({reasons})")
    _check_signs(samples)
    total = samples.P1 + samples.P2
    if np.ptp(total) <= _ONE_LEVEL * np.abs(total).mean():
        raise InvalidInput(
            f"all equilibria are at one co-contraction, P1 + P2 = {total.mean() / BAR:.3g} bar: they cannot tell how "
            "stiffness grows with pressure; repeat the sweep at two other sums"
        )
    moving = samples.direction[samples.direction != 0]
    if friction and moving.size and np.ptp(moving) == 0:
        way = "rising" if moving[0] > 0 else "falling"
        raise InvalidInput(
            f"all equilibria were reached with {way} θ: friction cannot be told from the force laws; add the sweep the "
            "other way, or pass friction=False and take the hysteresis as error"
        )


def _check_signs(samples: JointSamples) -> None:
    """Refuse data in which P1 does not raise θ or P2 does not lower it."""
    groups = np.eye(len(samples.groups))[samples.group]
    columns = np.column_stack([samples.P1 / BAR, samples.P2 / BAR, samples.torque, groups])
    if np.ptp(samples.P1) == 0 or np.ptp(samples.P2) == 0:
        held = "P1" if np.ptp(samples.P1) == 0 else "P2"
        raise InvalidInput(f"{held} was never changed: both pressures have to be swept")
    rise1, rise2 = np.linalg.lstsq(columns, samples.theta)[0][:2]
    if rise1 < 0 < rise2:
        raise InvalidInput(
            f"θ falls with P1 ({rise1 / DEG:.2g} deg/bar) and rises with P2 ({rise2 / DEG:.2g} deg/bar): the muscles "
            "are swapped, or the angle has the other sign"
        )
    if not rise1 > 0 > rise2:
        raise InvalidInput(
            f"θ changes by {rise1 / DEG:.2g} deg/bar with P1 and {rise2 / DEG:.2g} deg/bar with P2: in an antagonistic "
            "pair P1 raises and P2 lowers it"
        )


def check_weight(samples: JointSamples, deflection: Array, expected: Array) -> float:
    """Return the force scale [-] of a shape, from the `deflection` (n,) [rad] under weights and what it `expected` (n,)
    [rad].

    Refuses a weight that pulls the wrong way, or drowns in the scatter, and says which would not.
    """
    compliance = float(deflection @ expected / (expected @ expected))
    error = deflection - compliance * expected
    scatter = float(np.sqrt(error @ error / max(samples.n - 1, 1)))
    std = scatter / float(np.linalg.norm(expected))
    if compliance > _SEEN * std:
        return 1 / compliance
    W, most = float(np.abs(samples.torque).max()), float(np.abs(expected).max())
    if compliance < -_SEEN * std:
        raise InvalidInput(
            f"torque of {W:.3g} N·m moves the joint by {-compliance * most / DEG:.2g}° the wrong way: it has to be "
            "positive where the weight pulls θ down; turn its sign"
        )
    wanted = W * std / _WANTED / max(abs(compliance), std)
    raise InvalidInput(
        f"torque of {W:.3g} N·m moves the joint by {compliance * most / DEG:.2g}° ± {std * most / DEG:.2g}°, which "
        f"drowns in a scatter of {scatter / DEG:.2g}°: the force scale would be chance; hang about {wanted:.2g} N·m on "
        "either side"
    )
