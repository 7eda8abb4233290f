"""Joints as differential equations of their own, independent of the library and of the structure that it fits.

    J θ'' = R1 F1 - R2 F2 - b θ' - G sin θ - T_r + load,        R_i = R (1 ± e θ)
    F_i   = k_c max(s_i, 0),  s_i = l0 (ε_i - ε0_i) - (path shortened by θ)          the cable pulls, and gives
    c l0 ε_i' = g_i A(ε_i) P_i - E(ε_i) - Σ_j f_ij - v_i - F_i                       the muscle pulls at its cable
    f_ij' = k_j l0 ε_i' within [-h_j, H_j] P_i-wise, or Bouc–Wen's z                 hysteresis in the muscle
    v_i'  = k_v l0 ε_i' - v_i/τ_v                                                    creep
    P_i'  = κ/V_i (R T ṁ_i - (P_i + p_a) V_i'),   V_i = V_0 + l0 g_i ∫A dε           the gas's work is the muscle's

ε is the contraction ratio of a muscle, A its gain, E what its rubber resists, T_r friction of the bearing. ṁ comes
from a regulator that has an offset, a dead band, a delay that jitters, and either lags of its own for filling and
venting within a limit of the flow, the same behind a spool, or a valve through which gas flows as ISO 6358 has it,
choked or not.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from allocator.calculus import Array

FINE = 2.5e-4  # [s] step of integration
ATMOSPHERE, SUPPLY, KAPPA = 1.01325e5, 7.0e5, 1.3  # [Pa absolute], [-]
CHOKED = 0.3  # critical pressure ratio b of ISO 6358
SLIPS = 4  # elements of the hysteresis of a muscle
BRAID, TIPS, POWER, EXPONENTIAL = range(4)  # laws
LAGGED, SPOOLED, FLOWING = range(3)  # regulators


class Parts(NamedTuple):
    """Parameters of a stranger: numbers, and arrays (2,) of both muscles. SI units."""

    law: int
    radius: float  # of a braid [m]
    angle: float  # of its fibres [rad]
    shape: float  # of the other laws [-]
    rest_length: float  # l0 [m]
    contraction: float  # ε0 at θ = 0 [-]
    strength: Array  # g [-]
    rubber: float  # [N]
    void: float  # volume of gas at ε = 0 [m³]
    cable: float  # k_c [N/m]
    whole: Array  # 1 of a cable that holds, 0 of a broken one [-]
    inner_damping: float  # c [N·s/m]
    slip: Array  # H_j + h_j (SLIPS,) at 5 bar [N]
    spring: Array  # k_j (SLIPS,) [N/m]
    asymmetry: float  # share of H_j in it [-]
    slip_base: float  # share of it that does not grow with the pressure [-]
    bouc_wen: bool  # whether f follows Bouc and Wen's equation, else each element slips
    creep: float  # k_v [N/m]
    creep_time: float  # τ_v [s]
    lever: float  # R [m]
    eccentricity: float  # e [1/rad]
    inertia: float  # J [kg·m²]
    damping: float  # b [N·m·s/rad]
    gravity: float  # G [N·m]
    bearing: float  # greatest |T_r| [N·m]
    presliding: float  # of the bearing [rad]
    regulator: int
    up: Array  # lags [s]
    down: Array
    flow: float  # most [Pa/s]
    spool: float  # lag [s]
    conductance: float  # of a valve, as a rate at the supply into 0.3 l [Pa/s]
    opening: float  # error [Pa] at which it is wide open
    leak: float  # [1/s]
    dead_band: float  # [Pa], total
    offset: Array  # of regulators against sensors [Pa]


@njit(cache=True)
def gain(p, eps):
    """Return A(ε) [m²], its slope, and its integral from 0."""
    if p.law == BRAID or p.law == TIPS:
        k = 1.0 if p.law == BRAID else p.shape
        a, b = 3 / np.tan(p.angle) ** 2, 1 / np.sin(p.angle) ** 2
        area, x = np.pi * p.radius**2, 1 - k * eps
        return area * (a * x**2 - b), -2 * k * area * a * x, area * (a * (1 - x**3) / (3 * k) - b * eps)
    area = 5.0 * np.pi * p.radius**2
    if p.law == POWER:  # straight to where a braid of 25° has no gain left, bent by `shape`
        return (
            area * (1 - eps / 0.33 + p.shape * eps**2),
            area * (-1 / 0.33 + 2 * p.shape * eps),
            area * (eps - eps**2 / 0.66 + p.shape * eps**3 / 3),
        )
    fast = np.exp(-eps / 0.08)
    return (
        area * (p.shape * fast + 1 - p.shape - 2.2 * eps),
        area * (-p.shape * fast / 0.08 - 2.2),
        area * (0.08 * p.shape * (1 - fast) + (1 - p.shape) * eps - 1.1 * eps**2),
    )


@njit(cache=True)
def elastic(p, eps):
    """Return E(ε) [N] and its slope."""
    bent = np.exp(-eps / 0.05)
    return p.rubber * (1 - bent) * (1 + 3 * eps), p.rubber * (bent / 0.05 * (1 + 3 * eps) + 3 * (1 - bent))


@njit(cache=True)
def stretch(p, i, theta, eps):
    """Return the stretch of cable i [m], and its lever [m]."""
    sign = 1.0 if i == 0 else -1.0
    path = p.lever * (sign * theta + p.eccentricity * theta**2 / 2)
    return p.rest_length * (eps - p.contraction) - path, p.lever * (1 + sign * p.eccentricity * theta)


@njit(cache=True)
def slipped(p, f, P, eps, deps):
    """Move the elements' forces f (SLIPS,) [N] of a muscle that contracts by `deps`; return their sum."""
    scale = p.slip_base + (1 - p.slip_base) * max(P, 0.0) / 5e5
    move, total = p.rest_length * deps, 0.0
    for j in range(SLIPS):
        most = p.slip[j] * scale
        if most <= 0:
            continue
        up, down = p.asymmetry * most, (1 - p.asymmetry) * most
        if p.bouc_wen:
            bound = up if f[j] > 0 else down
            f[j] += p.spring[j] * move * (1 - abs(f[j] / bound) ** 1.5 * (0.3 + 0.7 * np.sign(move * f[j])))
        else:
            f[j] = min(max(f[j] + p.spring[j] * move, -down), up)
        total += f[j]
    return total


@njit(cache=True)
def volume(p, i, eps):
    """Return the volume of gas [m³] and its slope by ε."""
    A, _, integral = gain(p, eps)
    return p.void + p.rest_length * p.strength[i] * integral, p.rest_length * p.strength[i] * A


@njit(cache=True)
def filled(p, i, error, V, P):
    """Return the rate [Pa/s] that regulator and leak give at the `error` [Pa], without the motion's."""
    half = p.dead_band / 2
    error = np.sign(error) * max(abs(error) - half, 0.0)
    if p.regulator == FLOWING:
        s = min(max(error / p.opening, -1.0), 1.0)
        above, below = (SUPPLY, P + ATMOSPHERE) if s > 0 else (P + ATMOSPHERE, ATMOSPHERE)
        ratio = min(below / above, 1.0)
        passing = 1.0 if ratio < CHOKED else np.sqrt(max(1 - ((ratio - CHOKED) / (1 - CHOKED)) ** 2, 0.0))
        rate = p.conductance * s * passing * above / SUPPLY * 3e-4 / V
    else:
        rate = error / (p.up[i] if error > 0 else p.down[i])
        rate = min(max(rate, -p.flow), p.flow)
    return rate - p.leak * P * 3e-4 / V


@njit(cache=True)
def advance(p, x, f, told, until, load, gravity, inertia, duration, work):
    """Go on by `duration` [s]; x = (θ, ω, P (2), ε (2), spool (2), creep (2), bearing) and f (2, SLIPS) change.

    `told` (c, 2) [Pa] are commands and `until` (c,) [s] for how long each acts, from now. To `work` (3,) [J] are added
    the work of muscles on cables, of the gas on muscles, and of muscles against hysteresis.
    """
    t, k = 0.0, 0
    for _ in range(round(duration / FINE)):
        while k < len(until) - 1 and t >= until[k] - 1e-9:
            k += 1
        torque = -p.damping * x[1] - gravity * np.sin(x[0]) + load
        for i in range(2):
            P, eps = x[2 + i], x[4 + i]
            s, lever = stretch(p, i, x[0], eps)
            F = p.whole[i] * p.cable * max(s, 0.0)
            torque += lever * F if i == 0 else -lever * F
            A, _, _ = gain(p, eps)
            E, _ = elastic(p, eps)
            held = 0.0
            for j in range(SLIPS):
                held += f[i, j]
            pull = p.strength[i] * A * P
            deps = FINE * (pull - E - held - x[8 + i] - F) / (p.inner_damping * p.rest_length)
            slipped(p, f[i], P, eps, deps)
            if p.creep > 0:
                x[8 + i] += p.creep * p.rest_length * deps - FINE * x[8 + i] / p.creep_time
            V, slope = volume(p, i, eps)
            target = told[k, i] + p.offset[i]
            if p.regulator == SPOOLED:
                x[6 + i] += FINE * (target - x[6 + i]) / p.spool
                target = x[6 + i]
            rate = filled(p, i, target - P, V, P)
            x[2 + i] = max(P + FINE * rate - KAPPA * (P + ATMOSPHERE) * slope * deps / V, -0.9 * ATMOSPHERE)
            x[4 + i] = eps + deps
            work[0] += F * p.rest_length * deps
            work[1] += pull * p.rest_length * deps
            work[2] += held * p.rest_length * deps
        if p.bearing > 0:
            move = FINE * x[1] / p.presliding
            x[10] += move * (1 - abs(x[10]) * (0.3 + 0.7 * np.sign(move * x[10])))
            torque -= p.bearing * x[10]
        x[1] += FINE * torque / inertia
        x[0] += FINE * x[1]
        t += FINE
