"""Felt stiffness of a steady loop by springs that slip: a backbone and stops of the measured angle.

The torque of the muscles, without that of the inertia and the damping, is Kθ + Σ w_j s_j(θ; r_j) with stops s_j of half
widths r_j = ρ_j A on a grid of shares of the swing. As phasors Y of a tone's odd harmonics h,

    Σ g_i T_i,h + (J h²ω² - i h ω D) θ_h = K θ_h + Σ w_j S_j,h,        K, w_j ≥ 0                               (F1)

and the secant is K + Σ w_j ρ_j. The torque at the turns themselves is no measure of it: friction that reverses there
lets the acceleration jump, of which a sampled tone has the mean.
"""

import numpy as np

from allocator.calculus import Array
from mpc.bench.measuring.loops import Tone, refined

_SHARES = np.array([0.02, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8])  # ρ_j
_ERROR = 0.01  # [-] of the torque's fundamental, in any harmonic
_GRID = 360  # points per period


def stop(theta: Array, r: float) -> Array:
    """Return the stop e = clip(e + Δθ, ±r) (n,) [rad] of half width r along the angles (n,), from e = 0."""
    e, out = 0.0, [0.0]
    for step in np.diff(theta).tolist():
        e = max(-r, min(r, e + step))
        out.append(e)
    return np.array(out)


def solved(X: Array, y: Array) -> Array:
    """Return the nonnegative least-squares solution of X x = y, with scaled columns."""
    from scipy.optimize import nnls

    size = np.maximum(np.sqrt((X**2).mean(axis=0)), 1e-30)
    return np.asarray(nnls(X / size, y)[0] / size)


def secant(tone: Tone, strengths: Array, age: float, inertia: float, damping: float) -> float:
    """Return the stiffness [N·m/rad] between the turns of a tone, gravity included."""
    h, Y = tone.phasors(age)
    omega = h * tone.omega
    force = Y[:, 1:] @ strengths + (inertia * omega**2 - 1j * omega * damping) * Y[:, 0]
    X = np.column_stack([Y[:, 0], _stops(h, Y[:, 0])])
    angle, one, two = tone.noise
    error = np.sqrt((_ERROR * abs(force[0])) ** 2 + one**2 + two**2 + (inertia * omega**2 * angle) ** 2)
    rows, y = X / error[:, None], force / error
    found = solved(np.concatenate([rows.real, rows.imag]), np.concatenate([y.real, y.imag]))
    return float(found[0] + found[1:] @ _SHARES)


def _stops(h: Array, theta: Array) -> Array:
    """Return the phasors (odd harmonics, stops) of stops in the steady loop of the angle with phasors `theta`."""
    phase = 2 * np.pi * np.arange(_GRID) / _GRID
    angle = (np.exp(1j * np.outer(phase, h)) @ theta).real
    top = refined(phase, angle)
    half = top + phase[: _GRID // 2]  # from the upper turn down to the lower one; the other half is its mirror image
    waves = np.exp(1j * np.outer(half, h))
    angle = (waves @ theta).real
    A = angle[0]
    s = np.maximum(_SHARES * A - A + angle[:, None], -_SHARES * A)
    return np.asarray(4 / _GRID * waves.conj().T @ s)
