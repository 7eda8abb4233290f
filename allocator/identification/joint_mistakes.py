"""What can be seen to be wrong with measured equilibria before anything is fitted: one sentence each."""

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.identification.joint_samples import JointSamples
from allocator.units import BAR, DEG

_ONE_LEVEL = 0.03  # of the mean co-contraction
_SEEN = 3.0  # standard deviations from which on the deflection by a weight is not chance
_WANTED = 0.05  # relative accuracy of the deflection that a useful weight gives


def check_data(samples: JointSamples, friction: bool) -> None:
    """Slack joints, swapped muscles, one co-contraction only; with `friction` one direction of motion only."""
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
    """P1 has to raise θ and P2 to lower it."""
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


def check_weight(samples: JointSamples) -> None:
    """Refuse a weight whose deflection drowns in the scatter, and say which would not.

    θ is taken as a polynomial in (P1-P2)/(P1+P2) and 1/(P1+P2), the direction, and a deflection by T/(P1+P2): no
    muscle model is needed for this.
    """
    if not samples.loaded:
        return
    A = _smooth(samples)
    n, m = A.shape
    if n <= m + 2:
        return
    size = np.linalg.norm(A, axis=0)
    size[size == 0] = 1.0
    coefficients, _, rank, _ = np.linalg.lstsq(A / size, samples.theta, rcond=1e-10)
    error = samples.theta - A / size @ coefficients
    variance = error @ error / max(n - rank, 1)
    std = np.sqrt(variance * np.linalg.pinv((A / size).T @ (A / size), rcond=1e-10)[-1, -1])
    deflection = -coefficients[-1]
    if deflection > _SEEN * std:
        return
    W = np.abs(samples.torque).max()
    most = W / (samples.P1 + samples.P2)[np.abs(samples.torque).argmax()] * 4 * BAR / size[-1]
    wanted = W * std / _WANTED / max(abs(deflection), std)
    raise InvalidInput(
        f"torque of {W:.3g} N·m moves the joint by {deflection * most / DEG:.2g}° ± {std * most / DEG:.2g}°, which "
        f"drowns in a scatter of {np.sqrt(variance) / DEG:.2g}°: the force scale would be chance; hang about "
        f"{wanted:.2g} N·m on either side"
    )


def _smooth(samples: JointSamples) -> Array:
    total = (samples.P1 + samples.P2) / (4 * BAR)
    balance, weak = (samples.P1 - samples.P2) / (samples.P1 + samples.P2), 1 / total
    terms = [balance**i * weak**j for i in range(6) for j in range(3) if i + j <= 6 and (i or j)]
    groups = np.eye(len(samples.groups))[samples.group]
    ways = [samples.direction, samples.direction * np.abs(balance)] if (samples.direction != 0).any() else []
    return np.column_stack([*terms, groups, *ways, samples.torque * weak])


__all__ = ["check_data", "check_weight"]
