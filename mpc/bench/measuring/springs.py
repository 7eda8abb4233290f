"""Stiffness of steady loops by springs that slip: a backbone and stops of the measured angle.

Along steady loops between ±A, with stops s_j of half widths r_j,

    Σ g_i T_i - J θ'' - D θ' = K θ + Σ w_j s_j(θ; r_j),        K, w_j ≥ 0                                       (F1)

by least squares over the stroke, ∮ … |dθ|. With the r_j up to 0.8 A of one loop, its felt stiffness is the secant
K + Σ w_j r_j/A. The torque at the turns themselves is no measure of it: friction that reverses there lets the
acceleration jump, of which a sampled tone has the mean, or holds the joint while the torque changes. With loops of
several amplitudes and the r_j up to half the widest A, K is the backbone, whatever the force laws of the model.
"""

from collections.abc import Sequence

import numpy as np

from allocator.calculus import Array
from mpc.bench.measuring.loops import Tone

_SHARES = np.array([0.001, 0.03, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8])  # r_j/A of one loop …
_OF_WIDEST = np.geomspace(0.02, 0.5, 8)  # … and of several
SPRINGS = 0.15  # [-] standard deviation of the stiffness of hysteresis, which neighbouring stops share
_HARMONICS = 3  # odd ones: where friction reverses, higher ones of the acceleration oscillate
_PERIOD = 360  # points per period of a loop of springs


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
    found = _springs([tone], _SHARES, strengths, age, inertia, damping)
    return float(found[0] + found[1:] @ _SHARES)


def backbone(tones: Sequence[Tone], strengths: Array, age: float, inertia: float, damping: float) -> float:
    """Return the stiffness [N·m/rad] of slow tones without the springs that slip, gravity included."""
    return float(_springs(tones, _OF_WIDEST, strengths, age, inertia, damping)[0])


def _springs(
    tones: Sequence[Tone], shares: Array, strengths: Array, age: float, inertia: float, damping: float
) -> Array:
    """Return K and the w_j (1 + n,) [N·m/rad] of stops whose widths are `shares` (n,) of the widest swing."""
    X, y = [], []
    loops = [_loop(tone, strengths, age, inertia, damping) for tone in tones]
    widest = max(float(np.ptp(theta)) for theta, _, _ in loops) / 2
    for theta, omega, T in loops:
        A, up = np.ptp(theta) / 2, np.sign(omega)[:, None]
        r = np.minimum(shares * widest, A)
        stops = up * np.minimum(A + up * theta[:, None] - r, r)
        stroke = np.sqrt(np.abs(omega))
        stroke /= np.sqrt(np.mean((stroke * theta) ** 2))
        X.append(np.column_stack([theta, stops]) * stroke[:, None])
        y.append(T * stroke)
    return solved(np.concatenate(X), np.concatenate(y))


def _loop(tone: Tone, strengths: Array, age: float, inertia: float, damping: float) -> Array:
    """Return angles, angular velocities and torques (3, n) of the left side of (F1) along a period."""
    h, Y = (each[:_HARMONICS] for each in tone.phasors(age))
    waves = np.exp(1j * np.outer(2 * np.pi * np.arange(_PERIOD) / _PERIOD, h))
    rate = 1j * h * tone.omega * Y[:, 0]
    force = Y[:, 1:] @ strengths + inertia * (h * tone.omega) ** 2 * Y[:, 0] - damping * rate
    return np.asarray((waves @ np.column_stack([Y[:, 0], rate, force])).real.T)
