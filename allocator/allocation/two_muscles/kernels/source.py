"""Exact allocation of one target as plain Python, the common source of all compiled and printed forms.

`tondu_exact` answers for two equal Tondu2021 on a pulley, `affine_exact` for muscles affine in the pressure in any
geometry. They agree to rounding with the readable `allocator.allocation.two_muscles.exact` and `status`, for the
lexicographic priorities without a pull. There is no search, and no step depends on the data: clip the first target to
its interval, find both ends of its level in the box, clip the second target between them, invert.

Four forms share the source, and all give the same digits:

* Python, unchanged, in a few µs per target: scalar calls until `warm_up`;
* numba (`compiled`), also for calls from other compiled code. Arguments that are None (an absent limit) are compiled
  away. There are only conditional expressions and `sqrt`, so that the loops over arrays vectorise. It is one file
  because numba checks only one file to see whether its cached code is out of date;
* NumPy (`printer.to_numpy`), for arrays until `warm_up`;
* C (`printer.to_c`), for the export.

The printer requires a plain style: a tuple is unpacked into names or returned as names, and a name is first assigned
outside of branches.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba types the functions by their calls: numbers, arrays and None
from collections.abc import Callable
from math import inf, pi, sqrt

from allocator.allocation.status import CLOSED_FORM, Status
from allocator.joint.limits import Limit

MET = CLOSED_FORM.met  # of the torque or stiffness scale: a target missed by less is met
_NEWTON_STEPS = 4
_TURN = 2 * pi
_RISES = 1e-6  # of q: with a smaller gain of force by pressure the reference answers

# Statuses as plain numbers
EXACT, TORQUE_LIMITED, STIFFNESS_LIMITED = int(Status.EXACT), int(Status.TORQUE_LIMITED), int(Status.STIFFNESS_LIMITED)
CONFLICT, SLACK = int(Status.CONFLICT), int(Status.SLACK)
OUTSIDE_JOINT_RANGE, OUTSIDE_LIMITS = int(Status.OUTSIDE_JOINT_RANGE), int(Status.OUTSIDE_LIMITS)

# Limit flags of a muscle: lower bound, least force, greatest force, slew
AGONIST = tuple(map(int, (Limit.P1_LOWER, Limit.AGONIST_SLACK, Limit.AGONIST_FORCE, Limit.P1_RATE)))
ANTAGONIST = tuple(map(int, (Limit.P2_LOWER, Limit.ANTAGONIST_SLACK, Limit.ANTAGONIST_FORCE, Limit.P2_RATE)))


# --- both kernels: the box and the verdict --------------------------------------------------------------------------


def interval(bounds, near):
    """Return (low, high, status) of one muscle's pressure [Pa], as `allocator.joint.limits.PressureInterval`.

    `bounds`: supply, supply or validity, least force, greatest force, both ends of the slew limit [Pa]; ±inf if absent.
    The `Status` is exact, conflict, slack or outside the limits.
    """
    lo, hi, taut, ceiling, nearest, farthest = bounds
    most = hi if ceiling >= hi else clip(ceiling, lo, hi)
    low, high = clip(taut, lo, most), most
    if nearest > low or farthest < high:
        low, high = clip(low, nearest, farthest), clip(high, nearest, farthest)
    status = CONFLICT if taut > most + near or ceiling < lo - near else EXACT
    status = SLACK if taut > high + near else status
    status = OUTSIDE_LIMITS if nearest > most + near or farthest < lo - near else status
    return low, high, status


def clip(x, lo, hi):
    """Return `x` within [lo, hi]."""
    x = x if x > lo else lo
    return x if x < hi else hi


def binding(P, low, high, bounds, near, hi_limit, flags):
    """Return the flags of the limits that `P` in [low, high] lies on."""
    if low + near < P < high - near:
        return 0
    lo, hi, taut, ceiling, nearest, farthest = bounds
    lower, slack, force, rate = flags
    limits = (lower if -near <= P - lo <= near else 0) | (hi_limit if -near <= P - hi <= near else 0)
    limits = limits | (slack if -near <= P - taut <= near else 0) | (force if -near <= P - ceiling <= near else 0)
    return limits | (rate if P - nearest <= near or farthest - P <= near else 0)


def verdict(e_T, e_K, T_scale, K_scale, outside, status1, status2):
    """Return the `Status` of the targets missed, the joint range and the muscles; the last that applies in its list."""
    missed_T = TORQUE_LIMITED if abs(e_T) > MET * T_scale else EXACT
    status = missed_T | (STIFFNESS_LIMITED if abs(e_K) > MET * K_scale else EXACT)
    status = status if outside == 0 else OUTSIDE_JOINT_RANGE
    status = status if status > status1 else status1
    return status if status > status2 else status2


# --- two equal Tondu2021 on a pulley --------------------------------------------------------------------------------
# A muscle's force per area is f = q P - ε (c + g r) [Pa] with r = 1/(P + d). It is written out everywhere, because a
# Python call takes longer than the formula.


def tondu_exact(
    theta, K, T, p, min_force=0.0, max_force=None, P1_now=None, P2_now=None, max_step=None, stiffness_first=None
):
    """Answer one target: (P1, P2 [Pa], T [N·m] and K [N·m/rad] given, status, limits, sure); `p` from `TonduNumbers`.

    θ [rad], K [N·m/rad], T [N·m]; `min_force`, `max_force` [N], pressures now and `max_step` [Pa], or None;
    `stiffness_first`: None for priority "torque", True for "stiffness". `sure` is False if these formulas are not
    proved, beyond the fold of a muscle or outside their range of pressures: the reference must answer then.
    """
    S, R, l0, eps0, q, c, d, e, g, lo, hi, least, most, left, right, near, hi_limit1, hi_limit2, below, above = p
    outside = below if theta < left else (above if theta > right else 0)
    X = R * clip(theta, left, right) / l0
    eps1, eps2 = eps0 + X, eps0 - X
    taut1 = -inf if min_force is None else tondu_pressure(min_force, eps1, S, q, c, d, e)
    taut2 = -inf if min_force is None else tondu_pressure(min_force, eps2, S, q, c, d, e)
    ceiling1 = inf if max_force is None else tondu_pressure(max_force, eps1, S, q, c, d, e)
    ceiling2 = inf if max_force is None else tondu_pressure(max_force, eps2, S, q, c, d, e)
    nearest1, farthest1 = (-inf, inf) if max_step is None else (P1_now - max_step, P1_now + max_step)
    nearest2, farthest2 = (-inf, inf) if max_step is None else (P2_now - max_step, P2_now + max_step)
    bounds1 = (lo, hi, taut1, ceiling1, nearest1, farthest1)
    bounds2 = (lo, hi, taut2, ceiling2, nearest2, farthest2)
    (lo1, hi1, status1), (lo2, hi2, status2) = interval(bounds1, near), interval(bounds2, near)
    sure = lo1 >= least and lo2 >= least and hi1 <= most and hi2 <= most
    lo1, hi1 = (lo1, hi1) if sure else (clip(lo1, least, most), clip(hi1, least, most))
    lo2, hi2 = (lo2, hi2) if sure else (clip(lo2, least, most), clip(hi2, least, most))
    rl1, rl2, rh1, rh2 = 1 / (lo1 + d), 1 / (lo2 + d), 1 / (hi1 + d), 1 / (hi2 + d)
    least_rise = _RISES * q
    sure = sure and q + g * eps1 * rh1 * rh1 > least_rise and q + g * eps2 * rh2 * rh2 > least_rise
    box, muscles = (lo1, hi1, lo2, hi2, rl1, rh1, rl2, rh2), (eps1, eps2, q, c, d, g)
    T_unit, K_unit = S * R, S * R * R / l0
    tau, s = T / T_unit, (K / K_unit - 2 * c) / g
    kh1, kh2 = c + g * rh1, c + g * rh2
    fh1, fh2 = q * hi1 - eps1 * kh1, q * hi2 - eps2 * kh2
    P1, P2 = (
        tondu_torque_first(tau, s, fh1, fh2, box, muscles)
        if stiffness_first is None
        else tondu_stiffness_first(tau, s, box, muscles)
    )
    r1, r2 = 1 / (P1 + d), 1 / (P2 + d)
    f1, f2 = q * P1 - eps1 * (c + g * r1), q * P2 - eps2 * (c + g * r2)
    T_given, K_given = T_unit * (f1 - f2), K_unit * (2 * c + g * (r1 + r2))
    T_scale = T_unit * (abs(fh1) + abs(fh2)) + abs(T)
    K_scale = K_unit * (abs(kh1) + abs(kh2)) + abs(K)
    status = verdict(T_given - T, K_given - K, T_scale, K_scale, outside, status1, status2)
    limits1 = binding(P1, lo1, hi1, bounds1, near, hi_limit1, AGONIST)
    limits2 = binding(P2, lo2, hi2, bounds2, near, hi_limit2, ANTAGONIST)
    limits = limits1 | limits2 | outside
    return P1, P2, T_given, K_given, status, limits, sure


def tondu_torque_first(tau, s, fh1, fh2, box, muscles):
    """Return the pressures for τ = T/(S R), clipped to its range, and then for s, clipped to the torque level.

    `fh1`, `fh2`: the forces per area [Pa] at the upper ends of the box.
    """
    lo1, hi1, lo2, hi2, rl1, _rh1, rl2, _rh2 = box
    eps1, eps2, q, c, d, g = muscles
    fl1, fl2 = q * lo1 - eps1 * (c + g * rl1), q * lo2 - eps2 * (c + g * rl2)
    least, most = fl1 - fh2, fh1 - fl2
    too_low, too_high = tau <= least, tau >= most
    tau = clip(tau, least, most)
    # the level's low end: one pressure at its lower bound, the other gives the rest of the torque
    at1 = tau <= fl1 - fl2
    u = tondu_u(fl1 - tau if at1 else fl2 + tau, eps2 if at1 else eps1, q, c, d, g)
    a1, a2 = lo1 if at1 else clip(u - d, lo1, hi1), clip(u - d, lo2, hi2) if at1 else lo2
    # and its high end
    at1 = tau >= fh1 - fh2
    u = tondu_u(fh1 - tau if at1 else fh2 + tau, eps2 if at1 else eps1, q, c, d, g)
    b1, b2 = hi1 if at1 else clip(u - d, lo1, hi1), clip(u - d, lo2, hi2) if at1 else hi2
    # K grows as s falls
    at_a, at_b = s >= 1 / (a1 + d) + 1 / (a2 + d), s <= 1 / (b1 + d) + 1 / (b2 + d)
    P1, P2 = tondu_inverse(tau, s, box, muscles)
    P1, P2 = b1 if at_b else P1, b2 if at_b else P2
    P1, P2 = a1 if at_a else P1, a2 if at_a else P2
    P1, P2 = lo1 if too_low else P1, hi2 if too_low else P2
    P1, P2 = hi1 if too_high else P1, lo2 if too_high else P2
    return P1, P2


def tondu_stiffness_first(tau, s, box, muscles):
    """Return the pressures for s, clipped to [K(lo, lo), K(hi, hi)], and then for τ, clipped to the stiffness level."""
    lo1, hi1, lo2, hi2, rl1, rh1, rl2, rh2 = box
    eps1, eps2, q, c, d, g = muscles
    too_low, too_high = s >= rl1 + rl2, s <= rh1 + rh2
    s = clip(s, rh1 + rh2, rl1 + rl2)
    at1 = s - rl1 >= rh2  # the least torque: P1 at its lower bound, unless P2 would leave its upper one
    a1, a2 = lo1 if at1 else clip(1 / (s - rh2) - d, lo1, hi1), clip(1 / (s - rl1) - d, lo2, hi2) if at1 else hi2
    at1 = s - rh1 <= rl2  # the greatest torque
    b1, b2 = hi1 if at1 else clip(1 / (s - rl2) - d, lo1, hi1), clip(1 / (s - rh1) - d, lo2, hi2) if at1 else lo2
    fa1, fa2 = q * a1 - eps1 * (c + g * (1 / (a1 + d))), q * a2 - eps2 * (c + g * (1 / (a2 + d)))
    fb1, fb2 = q * b1 - eps1 * (c + g * (1 / (b1 + d))), q * b2 - eps2 * (c + g * (1 / (b2 + d)))
    at_a, at_b = tau <= fa1 - fa2, tau >= fb1 - fb2
    P1, P2 = tondu_inverse(tau, s, box, muscles)
    P1, P2 = b1 if at_b else P1, b2 if at_b else P2
    P1, P2 = a1 if at_a else P1, a2 if at_a else P2
    P1, P2 = lo1 if too_low else P1, lo2 if too_low else P2
    P1, P2 = hi1 if too_high else P1, hi2 if too_high else P2
    return P1, P2


def tondu_inverse(tau, s, box, muscles):
    """Return the pressures that give τ and s, clipped to the box.

    With the reciprocals r_i = 1/(P_i + d), q = a - b and g = e - cd, two Tondu2021 on a pulley give

        T/(S R) = q (P1 - P2) - 2 c X - g (ε1 r1 - ε2 r2),    K l0/(S R²) = 2 c + g (r1 + r2),    X = R θ/l0      (22)

    so that K fixes s = r1 + r2, and τ = T/(S R) leaves the cubic [C] of the report in z = (r1 - r2)/s. Over its β:

        κ z³ + t z² + (1 - κ) z - t = 0,    κ = -g ε0 s²/4q ≥ 0,    t = -(T/(S R) + 2 c X + g X s) s/4q

    Where |z| ≤ 1/2 and κ ≤ 0.8 (`TonduNumbers.settles`) a fixed number of steps leaves an error of 2e-14 at most:
    Halley's from z = 0, and then Newton's.
    """
    lo1, hi1, lo2, hi2, rl1, rh1, rl2, rh2 = box
    eps1, eps2, q, c, d, g = muscles
    s = clip(s, rh1 + rh2, rl1 + rl2)
    kappa = -g * (eps1 + eps2) * s * s / (8 * q)
    t = -(tau + (c + g * s / 2) * (eps1 - eps2)) * s / (4 * q)
    rest = 1 - kappa
    z = t * rest / (rest * rest + t * t)  # Halley's step from z = 0
    kappa2, kappa3, t2 = 2 * kappa, 3 * kappa, 2 * t
    for _ in range(_NEWTON_STEPS):  # z - p(z)/p'(z), in which all terms have one sign: nothing cancels
        z = ((kappa2 * z + t) * z * z + t) / ((kappa3 * z + t2) * z + rest)
    P1, P2 = clip(2 / (s * (1 + z)) - d, lo1, hi1), clip(2 / (s * (1 - z)) - d, lo2, hi2)
    return P1, P2


def tondu_pressure(F, eps, S, q, c, d, e):
    """Return `Tondu2021.pressure`, equal to the last digit, so that the box is the reference's."""
    q1, q0 = q * d - c * eps - F / S, e * eps + d * F / S  # q P² + q1 P - q0 = 0
    square = q1 * q1 + 4 * q * q0
    return 2 * q0 / (q1 - sqrt(square)) if square >= 0 else inf


def tondu_u(f, eps, q, c, d, g):
    """Return u = P + d for the force `f` per area: the smaller root of q u² - h u - ε g = 0, or inf."""
    h = q * d + c * eps + f
    square = h * h + 4 * q * eps * g
    return (h - sqrt(square)) / (2 * q) if square >= 0 else inf


# --- affine muscles, any geometry -----------------------------------------------------------------------------------


def affine_exact(
    theta,
    K,
    T,
    one,
    two,
    p,
    min_force=0.0,
    max_force=None,
    P1_now=None,
    P2_now=None,
    max_step=None,
    stiffness_first=None,
):
    """Answer one target as `tondu_exact` does; `one` and `two` are the muscles at θ clipped to the joint range.

    They are (A, B, a, k', k0): F = A P + B [N], moment arm a [m], stiffness that the muscle adds k0 + k' P [N·m/rad];
    `p` comes from `AffineNumbers`.
    """
    lo, most1, most2, left, right, near, hi_limit1, hi_limit2, below, above = p
    (A1, B1, arm1, k1, k01), (A2, B2, arm2, k2, k02) = one, two
    outside = below if theta < left else (above if theta > right else 0)
    rises = A1 > 0 and A2 > 0
    A1, A2 = A1 if rises else 1.0, A2 if rises else 1.0
    taut1 = -inf if min_force is None else (min_force - B1) / A1
    taut2 = -inf if min_force is None else (min_force - B2) / A2
    ceiling1 = inf if max_force is None else (max_force - B1) / A1
    ceiling2 = inf if max_force is None else (max_force - B2) / A2
    nearest1, farthest1 = (-inf, inf) if max_step is None else (P1_now - max_step, P1_now + max_step)
    nearest2, farthest2 = (-inf, inf) if max_step is None else (P2_now - max_step, P2_now + max_step)
    bounds1 = (lo, most1, taut1, ceiling1, nearest1, farthest1)
    bounds2 = (lo, most2, taut2, ceiling2, nearest2, farthest2)
    (lo1, hi1, status1), (lo2, hi2, status2) = interval(bounds1, near), interval(bounds2, near)
    box, t1, t2 = (lo1, hi1, lo2, hi2), arm1 * A1, -arm2 * A2
    T0, K0 = arm1 * B1 - arm2 * B2, k01 + k02
    sure = rises and t1 * k2 - t2 * k1 > 0 and k1 != 0 and k2 != 0
    P1, P2 = (
        affine_lexicographic(T - T0, t1, t2, K - K0, k1, k2, box)
        if stiffness_first is None
        else affine_lexicographic(K - K0, k1, k2, T - T0, t1, t2, box)
    )
    F1, F2 = A1 * P1 + B1, A2 * P2 + B2
    T_given, K_given = arm1 * F1 - arm2 * F2, K0 + k1 * P1 + k2 * P2
    T_scale = arm1 * abs(A1 * hi1 + B1) + arm2 * abs(A2 * hi2 + B2) + abs(T)
    K_scale = abs(k01 + k1 * hi1) + abs(k02 + k2 * hi2) + abs(K)
    status = verdict(T_given - T, K_given - K, T_scale, K_scale, outside, status1, status2)
    limits1 = binding(P1, lo1, hi1, bounds1, near, hi_limit1, AGONIST)
    limits2 = binding(P2, lo2, hi2, bounds2, near, hi_limit2, ANTAGONIST)
    limits = limits1 | limits2 | outside
    return P1, P2, T_given, K_given, status, limits, sure


def affine_lexicographic(X, x1, x2, Y, y1, y2, box):
    """Return the pressures with x1 P1 + x2 P2 nearest to X, and among these with y1 P1 + y2 P2 nearest to Y.

    A level of the first is a straight line, on which the second is affine. From m_i to M_i the first grows.
    """
    lo1, hi1, lo2, hi2 = box
    x1, x2 = x1 if x1 != 0 else 1.0, x2 if x2 != 0 else 1.0
    m1, M1 = lo1 if x1 > 0 else hi1, hi1 if x1 > 0 else lo1
    m2, M2 = lo2 if x2 > 0 else hi2, hi2 if x2 > 0 else lo2
    too_low, too_high = x1 * m1 + x2 * m2 >= X, x1 * M1 + x2 * M2 <= X
    X = clip(X, x1 * m1 + x2 * m2, x1 * M1 + x2 * M2)
    at2 = x1 * m1 + x2 * M2 <= X  # the end of the line at m1 or M2
    a1, a2 = clip((X - x2 * M2) / x1, lo1, hi1) if at2 else m1, M2 if at2 else clip((X - x1 * m1) / x2, lo2, hi2)
    at1 = x1 * M1 + x2 * m2 <= X  # and that at M1 or m2
    b1, b2 = M1 if at1 else clip((X - x2 * m2) / x1, lo1, hi1), clip((X - x1 * M1) / x2, lo2, hi2) if at1 else m2
    Ya, Yb = y1 * a1 + y2 * a2, y1 * b1 + y2 * b2
    share = (Y - Ya) / (Yb - Ya if Yb != Ya else 1.0)
    P1, P2 = a1 + share * (b1 - a1), a2 + share * (b2 - a2)
    P1, P2 = b1 if share >= 1 else P1, b2 if share >= 1 else P2
    P1, P2 = a1 if share <= 0 else P1, a2 if share <= 0 else P2
    P1, P2 = m1 if too_low else P1, m2 if too_low else P2
    P1, P2 = M1 if too_high else P1, M2 if too_high else P2
    return P1, P2


# --- arrays ---------------------------------------------------------------------------------------------------------


def odd(theta, K, T):
    """Return 1 for an angle of more than a turn, a stiffness not positive, or a value not finite; else 0."""
    return 0 if abs(theta) <= _TURN and 0 < K < inf and abs(T) < inf else 1


def tondu_batch(theta, K, T, p, min_force, max_force, P1_now, P2_now, max_step, stiffness_first, out):
    """Fill `out`, arrays (n,) of the results of `tondu_exact`; return the numbers of odd targets and unsure answers."""
    P1, P2, T_given, K_given, status, limits, sure = out
    strange = unsure = 0
    for i in range(theta.size):
        now1, now2 = None if P1_now is None else P1_now[i], None if P2_now is None else P2_now[i]
        step = None if max_step is None else max_step[i]
        P1[i], P2[i], T_given[i], K_given[i], status[i], limits[i], sure[i] = tondu_exact(
            theta[i], K[i], T[i], p, min_force, max_force, now1, now2, step, stiffness_first
        )
        strange += odd(theta[i], K[i], T[i])
        unsure += 0 if sure[i] else 1
    return strange, unsure


def affine_batch(theta, K, T, one, two, p, min_force, max_force, P1_now, P2_now, max_step, stiffness_first, out):
    """Fill `out` as `tondu_batch` does, by `affine_exact`; `one` and `two` are tuples of arrays (n,)."""
    P1, P2, T_given, K_given, status, limits, sure = out
    strange = unsure = 0
    (A1, B1, arm1, k1, k01), (A2, B2, arm2, k2, k02) = one, two
    for i in range(theta.size):
        now1, now2 = None if P1_now is None else P1_now[i], None if P2_now is None else P2_now[i]
        step = None if max_step is None else max_step[i]
        first, second = (A1[i], B1[i], arm1[i], k1[i], k01[i]), (A2[i], B2[i], arm2[i], k2[i], k02[i])
        P1[i], P2[i], T_given[i], K_given[i], status[i], limits[i], sure[i] = affine_exact(
            theta[i], K[i], T[i], first, second, p, min_force, max_force, now1, now2, step, stiffness_first
        )
        strange += odd(theta[i], K[i], T[i])
        unsure += 0 if sure[i] else 1
    return strange, unsure


FUNCTIONS: tuple[Callable[..., object], ...] = (
    *(interval, clip, binding, verdict),
    *(tondu_exact, tondu_torque_first, tondu_stiffness_first, tondu_inverse, tondu_u, tondu_pressure),
    *(affine_exact, affine_lexicographic, odd),
)
