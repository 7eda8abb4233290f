"""Joints with their own differential equations, independent of the library and its fitted models.

    J ω' = R (F1 - F2) - b ω - T_h,   F = A(ε) P - B(ε),   ε = ε0 ± R θ/l0
    T_h = T_m z,   z' = ω/δ (1 - |z|ⁿ (β sgn(ω z) + γ)),   T_m = K_m w/2 (s0 + (1 - s0)(P1 + P2)/5 bar)

A braid's law with rubber, muscles of unequal strength, Bouc–Wen hysteresis, regulators with lags that differ by a
quarter from each other and between rising and falling, a dead band, a limit of the flow and a dead time; with `gas`,
the gas that the motion compresses, whose work is the muscle's. The joint given to a fit has only the braid, so its
stiffness is off by about a tenth.
"""

from typing import Any, NamedTuple

import numpy as np

from allocator import BAR, DEG, AntagonistJoint, Pulley
from allocator.calculus import Array
from allocator.muscles.models.mckibben import TonduLopez1995

RADIUS, LENGTH, MIDDLE = 0.02, 0.25, 0.13  # R [m], l0 [m], ε0 [-]
BRAID, ANGLE = 0.01, 23 * DEG  # of a muscle at rest [m], [rad]
FINE, STEP, SECONDS = 5e-4, 0.02, 90.0  # [s]
ATMOSPHERE, KAPPA = 1.01325e5, 1.3


class Joints(NamedTuple):
    """Parameters of n joints; arrays (n,), of both muscles (2, n)."""

    inertia: Array  # [kg·m²]
    damping: Array  # [N·m·s/rad]
    strength: Array  # [-]
    rubber: Array  # [N]
    width: Array  # of the loop at 5 bar [rad]
    presliding: Array  # [rad]
    base: Array  # [-]
    up: Array  # [s]
    down: Array  # [s]
    dead_time: Array  # [s]
    dead_band: Array  # [Pa]
    flow: Array  # [Pa/s]


def drawn(seeds: Any) -> Joints:
    """Return the joints of these seeds."""
    rows: list[list[Any]] = []
    for seed in seeds:
        rng = np.random.default_rng([seed, 71])
        inertia = float(np.exp(rng.uniform(np.log(0.004), np.log(0.12))))
        lag = rng.uniform(0.06, 0.16) * np.exp(rng.normal(0, 0.2, 2))
        width = rng.uniform(2.0, 6.0) * DEG
        row = [inertia, 2 * rng.uniform(0.15, 0.6) * np.sqrt(7.0 * inertia), 1 + rng.normal(0, 0.06, 2)]
        row += [rng.uniform(20, 60, 2), width, width * rng.uniform(0.15, 0.4), rng.uniform(0.2, 0.9)]
        row += [lag, lag * rng.uniform(1.0, 1.7), rng.uniform(0.01, 0.06), rng.choice([0.0, 0.1, 0.2]) * BAR]
        rows.append([*row, rng.choice([4 * BAR, 8 * BAR, np.inf])])
    return Joints(*(np.array(column, float).T for column in zip(*rows, strict=True)))


def gain(eps: Array) -> tuple[Array, Array]:
    """Return A(ε) [m²] of the braid, and its slope."""
    a, b, area = 3 / np.tan(ANGLE) ** 2, 1 / np.sin(ANGLE) ** 2, np.pi * BRAID**2
    return area * (a * (1 - eps) ** 2 - b), -2 * area * a * (1 - eps)


def forces(joints: Joints, theta: Array, P: Array) -> tuple[Array, Array]:
    """Return F (2, n) [N] and dF/dε at the angles (n,) [rad] and the pressures (2, n) [Pa]."""
    eps = MIDDLE + np.array([[1.0], [-1.0]]) * RADIUS / LENGTH * theta
    A, slope = gain(eps)
    bent = np.exp(-eps / 0.05)
    force = joints.strength * A * P - joints.rubber * (1 - bent) * (1 + 3 * eps)
    return force, joints.strength * slope * P - joints.rubber * (bent / 0.05 * (1 + 3 * eps) + 3 * (1 - bent))


def stiffness(joints: Joints, theta: Array, P: Array) -> Array:
    """Return the isobaric stiffness (n,) [N·m/rad]."""
    return np.asarray(-(RADIUS**2) / LENGTH * forces(joints, theta, P)[1].sum(axis=0))


def simulated(joints: Joints, u: Array, gas: bool) -> tuple[Array, Array]:
    """Return θ (m, n) [rad] and P (m, 2, n) [Pa] under the commands u (m, 2, n) [Pa], a row every `STEP`."""
    n, every = joints.inertia.size, round(STEP / FINE)
    theta, omega, z, P = np.zeros(n), np.zeros(n), np.zeros(n), u[0].copy()
    usual = stiffness(joints, theta, np.full((2, n), 2.5 * BAR))
    late = np.round(joints.dead_time / FINE).astype(int)
    turned, filled = np.empty((len(u), n)), np.empty((len(u), 2, n))
    signs, columns = np.array([[1.0], [-1.0]]), np.arange(n)
    for k in range(len(u) * every):
        if k % every == 0:
            turned[k // every], filled[k // every] = theta, P
        acting = np.maximum(k - late, 0) // every
        error = u[acting, :, columns].T - P
        error = np.sign(error) * np.maximum(np.abs(error) - joints.dead_band / 2, 0)
        rate = np.clip(error / np.where(error > 0, joints.up, joints.down), -joints.flow, joints.flow)
        if gas:
            eps = MIDDLE + signs * RADIUS / LENGTH * theta
            volume = np.pi * BRAID**2 * LENGTH * (1 - eps) * (1 / np.sin(ANGLE) ** 2 - ((1 - eps) / np.tan(ANGLE)) ** 2)
            swell = LENGTH * gain(eps)[0] * signs * RADIUS / LENGTH * omega
            rate = rate - KAPPA * (P + ATMOSPHERE) * swell / volume
        P = P + FINE * rate
        width = joints.base + (1 - joints.base) * P.sum(axis=0) / (5 * BAR)
        torque = RADIUS * (signs * forces(joints, theta, P)[0]).sum(axis=0) - usual * joints.width / 2 * width * z
        omega = omega + FINE * (torque - joints.damping * omega) / joints.inertia
        z = z + FINE * omega / joints.presliding * (1 - np.abs(z) ** 1.5 * (0.7 * np.sign(omega * z) + 0.3))
        theta = theta + FINE * omega
    return turned, filled


def commands(seed: int, rows: int) -> Array:
    """Return random steps (rows, 2) [Pa] of both pressures."""
    rng = np.random.default_rng([seed, 5])
    u, until, told = np.full(2, 2.5 * BAR), 50, np.empty((rows, 2))
    for k in range(rows):
        if k == until:
            u, until = rng.uniform(1.7, 4.0, 2) * BAR, k + int(rng.uniform(0.5, 1.5) / STEP)
        told[k] = u
    return told


def given_joint() -> AntagonistJoint:
    """Return the joint given to a fit: only the braid's law, as from a data sheet."""
    muscle = TonduLopez1995(BRAID, ANGLE)
    return AntagonistJoint(Pulley(LENGTH, RADIUS, MIDDLE), muscle, muscle)


def truths(joints: Joints, i: int, theta: Array, P: Array) -> dict[str, float]:
    """Return the truth by the names of a fit's parameters."""
    one = Joints(*(part[..., i : i + 1] for part in joints))
    K = float(stiffness(one, np.array([theta.mean()]), P.mean(axis=0)[:, None])[0])
    at_five = np.moveaxis(P, 1, 0) * (5 * BAR / P.sum(axis=1))
    many = Joints(*(np.broadcast_to(part, (*part.shape[:-1], theta.size)) for part in one))
    usual = stiffness(one, np.zeros(1), np.full((2, 1), 2.5 * BAR))[0]
    return {
        "inertia": one.inertia[0] / K,
        "damping": one.damping[0] / K,
        "loop_width": float(np.mean(usual * one.width[0] / stiffness(many, theta, at_five))),
        "dead_time": one.dead_time[0],
        "dead_band": one.dead_band[0],
        "filling": 1 / one.flow[0],
        "lag_up": float(np.sqrt(one.up.prod())),
        "lag_down": float(np.sqrt(one.down.prod())),
        "lag_ratio": one.up[1, 0] / one.up[0, 0],
    }
