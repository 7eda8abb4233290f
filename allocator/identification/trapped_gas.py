"""Identification of a joint's gas from a log of motion with shut valves.

Valves are shut by command, or if the commands rest within the regulators' dead band (`at_rest`). Then (P + p_a) V^κ of
each muscle is constant, V = V_0 + ΔV(P, θ) with ΔV = L ∫ F_P dε from the muscle's law, so that

    ln(P + p_a) + κ ln V = a constant of each rest, and a drift of the time (a valve that leaks a little)

With V̄ and ΔV̄ at the middle of the log, ρ = κ/V̄, w = 1/V̄ and δ = ΔV - ΔV̄, that is the least squares of

    ln(P + p_a) + ρ ln(1 + w δ)/w,        to first order ln(P + p_a) + ρ δ - ρ w δ²/2

ρ is the slope, identified by any motion: κ/V^eff = ρ/(1 + ρ (P + p_a) ∂V/∂P). w is its curvature, identified by a large
angle, or by two co-contractions of muscles whose volume depends on the pressure. Without it κ and V_0 cannot be
separated.

The ± are those of white noise, or of the sandwich estimator over blocks of the log if these are clearly larger: the
residuals of a joint that deviates from its law are not white.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import Gas
from allocator.joint.one_muscle import OneMuscle
from allocator.units import BAR

_BLOCKS = 24  # of the sandwich estimator
_LEAST = 4 * _BLOCKS  # samples
_COLOURED = 1.7  # times the variance of white noise: exceeded by that of the blocks by chance in 1 % of logs
_APART = 4.0  # standard deviations of w from 0 at which κ and V_0 can be separated
_SMALL = 1e-5  # w δ below which the series of the logarithm is used


class Uncertain(NamedTuple):
    """Number with its standard deviation."""

    value: float
    std: float

    def __str__(self) -> str:
        """Return both numbers."""
        return f"{self.value:.4g} ± {self.std:.2g}"


@dataclass(frozen=True)
class TrappedGas:
    """Gas of one muscle; `kappa` and `rest_volume` are None if the log determines only their relation."""

    theta: float  # middle of the log, the angle of `stiffening` [rad]
    P: float  # [Pa]
    stiffening: Uncertain  # κ/V^eff [1/m³]
    ratio: Uncertain  # κ/V [1/m³]
    swell: float  # ΔV = V - V_0 there [m³]
    kappa: Uncertain | None  # κ [-]
    rest_volume: Uncertain | None  # V_0, tubing included [m³]
    residual: float  # standard deviation of the residual pressure [Pa]

    def volume_for(self, kappa: float) -> Uncertain:
        """Return the V_0 [m³] for a κ known from elsewhere."""
        volume = kappa / self.ratio.value
        return Uncertain(volume - self.swell, volume * self.ratio.std / self.ratio.value)

    def __str__(self) -> str:
        """Return the estimates in words."""
        at = f"κ/V^eff = {self.stiffening} 1/m³ at {self.P / BAR:.2g} bar"
        if self.kappa and self.rest_volume:
            cm3 = Uncertain(*(1e6 * value for value in self.rest_volume))
            return f"{at}; κ = {self.kappa}, V_0 = {cm3} cm³."
        low, high = (1e6 * self.volume_for(kappa).value for kappa in (1.0, 1.4))
        apart = f"κ and V_0 are not told apart: V_0 = {low:.3g} cm³ if κ = 1, {high:.3g} cm³ if κ = 1.4"
        return f"{at}; {apart}; turn the joint farther."


@dataclass(frozen=True)
class GasFit:
    """Fitted gas of both muscles."""

    joint: AntagonistJoint
    agonist: TrappedGas
    antagonist: TrappedGas

    @property
    def kappa(self) -> Uncertain | None:
        """Return κ of both muscles, weighted by their precision; None if neither determines it."""
        known = [gas.kappa for gas in (self.agonist, self.antagonist) if gas.kappa]
        if not known:
            return None
        weights = np.array([1 / k.std**2 for k in known])
        return Uncertain(float(np.average([k.value for k in known], weights=weights)), float(weights.sum() ** -0.5))

    def fitted(self, kappa: float | None = None) -> AntagonistJoint:
        """Return the joint with this gas: V_0 of both muscles, and κ.

        Raises InvalidInput if the log cannot separate `kappa` from the volumes and it is not given.
        """
        if kappa is None:
            if self.kappa is None:
                raise InvalidInput("kappa [-] has to be given: this log tells only κ/V, " + self.message)
            kappa = self.kappa.value
        one, two = (
            replace(muscle, rest_volume=gas.volume_for(kappa).value, tube_volume=0.0)
            for muscle, gas in ((self.joint.agonist, self.agonist), (self.joint.antagonist, self.antagonist))
        )
        return replace(self.joint, agonist=one, antagonist=two, gas=replace(self.joint.gas, kappa=kappa))

    @property
    def message(self) -> str:
        """Return a sentence on each muscle."""
        return f"Agonist: {self.agonist} Antagonist: {self.antagonist}"


def fit_gas(
    joint: AntagonistJoint, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike, rest: ArrayLike, t: ArrayLike | None = None
) -> GasFit:
    """Identify the gas of `joint` from a log with shut valves.

    Parameters
    ----------
    joint
        Its muscle laws give the changes of volume, and its `gas` the atmosphere; its κ and V_0 are not used.
    theta, P1, P2
        Angle [rad] and pressures [Pa] (n,), in the order of time.
    rest
        Number of each sample's rest (n,): 0, 1, 2, …, from `at_rest`; negative if the valves may be open.
    t
        Time [s] (n,); without it samples count as equally spaced.

    Raises
    ------
    InvalidInput
        For arrays that do not fit together, fewer than 96 samples at rest, and a joint that was not turned.
    """
    theta, P1, P2 = checks.angle("theta", theta), checks.pressure("P1", P1), checks.pressure("P2", P2)
    rest, t = np.asarray(rest), np.arange(theta.size) if t is None else checks.real("t", t, "s")
    shapes = {"theta": theta.shape, "P1": P1.shape, "P2": P2.shape, "rest": rest.shape, "t": t.shape}
    if theta.ndim != 1 or len(set(shapes.values())) > 1:
        raise InvalidInput(f"theta, P1, P2, rest and t have to be columns of one length, not {shapes}")
    kept = rest >= 0
    if kept.sum() < _LEAST:
        raise InvalidInput(f"only {kept.sum()} samples have shut valves; {_LEAST} are needed")
    free = _without_drift(rest[kept], t[kept].astype(float))
    sides = zip(joint.sides(theta[kept]), (P1, P2), strict=True)
    middle = float(np.median(theta[kept]))
    return GasFit(joint, *(_fitted(side, middle, P[kept], free, joint.gas) for side, P in sides))


def at_rest(commands: ArrayLike, P1: ArrayLike, P2: ArrayLike, dead_band: float) -> Array:
    """Return the number of each sample's rest (n,), -1 if a valve may be open.

    At rest both `commands` (n, 2) [Pa] are constant, and both pressures (n,) [Pa] within half the `dead_band` (total,
    [Pa]) of them. Raises InvalidInput for arrays that do not fit together and for a dead band of zero.
    """
    u = checks.pressure("commands", commands)
    P = np.stack([checks.pressure("P1", P1), checks.pressure("P2", P2)], axis=1)
    if u.shape != P.shape:
        raise InvalidInput(f"commands have the shape {u.shape}, not that of the pressures, {P.shape}")
    if not dead_band > 0:
        raise InvalidInput(f"dead_band = {dead_band:g} Pa has to be positive: without one no valve is ever shut")
    shut: Mask = np.asarray((np.abs(u - P) < dead_band / 2).all(axis=1))
    same = np.append(False, (u[1:] == u[:-1]).all(axis=1))
    begins = shut & ~(same & np.append(False, shut[:-1]))
    return np.where(shut, np.cumsum(begins) - 1, -1)


def _without_drift(rest: Array, t: Array) -> Callable[[Array], Array]:
    """Return a function that removes a constant and a drift from the columns of an array, rest by rest."""
    bases: list[tuple[Mask, Array]] = []
    for number in np.unique(rest):
        own = rest == number
        columns = np.stack([np.ones(own.sum()), t[own] - t[own].mean()], axis=1)
        bases.append((own, np.linalg.qr(columns)[0]))

    def free(values: Array) -> Array:
        left = np.array(values, float)
        for own, basis in bases:
            left[own] -= basis @ (basis.T @ left[own])
        return left

    return free


def _fitted(side: OneMuscle, theta: float, P: Array, free: Callable[[Array], Array], gas: Gas) -> TrappedGas:
    """Return the gas of one muscle at `theta` [rad], fitted at the angles of the log and the pressures `P` (n,)."""
    from scipy.optimize import least_squares

    swell = side.rest_length * side.muscle.gain_integral(P, side.contraction)
    middle, absolute = float(np.median(swell)), P + gas.atmosphere
    delta = swell - middle
    y, scale = free(np.log(absolute)), float(np.std(free(delta)))
    if not scale > 1e-3 * abs(middle) or not np.isfinite(scale):
        raise InvalidInput(f"the {side.name} was not turned: its volume changed by {scale * 1e6:.2g} cm³ only")

    def residuals(p: Array) -> Array:
        return np.asarray(y + p[0] * free(_log(p[1] / scale, delta)) / scale)

    start = -(y @ free(delta)) / (free(delta) @ free(delta)) * scale
    found = least_squares(residuals, [start, 0.0], x_scale=[max(abs(start), 1e-9), 1.0], method="lm", xtol=1e-14)
    covariance, (rho, w) = _covariance(found.jac, found.fun) / scale**2, found.x / scale
    at = float(np.median(P))
    by_pressure = float(np.median(side.rest_length * side.muscle.gain_integral_slope(P, side.contraction)))
    stretch = 1 + rho * (at + gas.atmosphere) * by_pressure
    rho_std, w_std = np.sqrt(np.diag(covariance)).tolist()
    apart = w > _APART * w_std
    by_both = np.array([1 / w, -rho / w**2]) if apart else np.zeros(2)  # of κ = ρ/w
    return TrappedGas(
        theta=theta,
        P=at,
        stiffening=Uncertain(float(rho / stretch), float(rho_std / stretch**2)),
        ratio=Uncertain(float(rho), float(rho_std)),
        swell=middle,
        kappa=Uncertain(float(rho / w), float(np.sqrt(by_both @ covariance @ by_both))) if apart else None,
        rest_volume=Uncertain(float(1 / w - middle), float(w_std / w**2)) if apart else None,
        residual=float(np.std(found.fun) * np.mean(absolute)),
    )


def _covariance(J: Array, r: Array) -> Array:
    """Return the covariance (2, 2) of the parameters from the Jacobian `J` (n, 2) and the residuals `r` (n,)."""
    H = np.linalg.pinv(J.T @ J)
    white = H * (r @ r) / (r.size - 2)
    scores = np.array([J[b].T @ r[b] for b in np.array_split(np.arange(r.size), _BLOCKS)])
    sandwich = H @ scores.T @ scores @ H * (_BLOCKS / (_BLOCKS - 2))
    excess = float((np.diag(sandwich) / np.maximum(np.diag(white), 1e-300)).max())
    return np.asarray(white * (excess if excess > _COLOURED else 1.0))


def _log(w: float, delta: Array) -> Array:
    """Return ln(1 + w δ)/w, also for w near 0."""
    x = w * delta
    if np.abs(x).max() < _SMALL:
        return np.asarray(delta * (1 - x / 2))
    return np.asarray(np.log1p(np.maximum(x, -0.999)) / w)
