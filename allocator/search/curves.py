"""Plane curve P ↦ (t(P), k(P)) of each muscle at a fixed angle, in numbers that a compiled loop takes.

A curve is a row of segments between the kinks of the muscle's law. On a segment t and k are combinations of the same
few functions of the pressure (`allocator.muscles.basis`):

    RATIONAL     1, P, r = 1/(P + c)
    EXPONENTIAL  P, P E, P E²,  E = exp(-P/h)
    QUADRATIC    1, P, P²
    CHEBYSHEV    T_0(z) … T_n(z),  z = (P - c)/h

Cut where t' = 0, where k' = 0 and where the curve bends the other way, W = t'k'' - t''k' = 0, it falls into *pieces* on
which t, k and the slope dk/dt are monotone. As

    d²k/dt² = W/t'³ = -∂_P(F_Pε/F_P)/(l0 F_P)

the geometry has gone: where a curve bends which way belongs to the muscle law alone. No cut is skipped: they are found
in closed form, by Rolle's theorem down a chain of derivatives, or by bounds on the derivatives of a polynomial.

Plain Python without NumPy, compiled or not, as in `allocator.allocation`. A segment is a row of numbers
(kind, c, h, lo, hi, n, t_1 … t_n, k_1 … k_n), zeros behind; a piece the tuple (number of the segment, a, b, values of
`at` at a, values at b).
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba compiles the functions for lists and for arrays, so that they have no types
from collections.abc import Callable
from math import exp, sqrt

RATIONAL, EXPONENTIAL, QUADRATIC, CHEBYSHEV = 0.0, 1.0, 2.0, 3.0
T_K, K_T, T_P, K_P, P_T, P_K = range(6)  # views of a curve: what is its x, and what its y
HEAD = 6  # numbers of a segment before its coefficients
_FINEST = 2.0**-12  # of a segment: a zero of a polynomial is looked for no closer than this to another one
_NOISE = 1e-11  # of the bound on a polynomial's derivatives: rounding
_STEPS = 80  # of a root finding; about five are used
_NEAR = 1e-13  # of an interval: a root is not sought closer than this


# --- values ---------------------------------------------------------------------------------------------------------


def at(P, segment, view):
    """Return (x, y, x', y') at the pressure P in a view of the curve."""
    t, k, dt, dk = torque_and_stiffness(P, segment)
    if view == T_K:
        return t, k, dt, dk
    if view == K_T:
        return k, t, dk, dt
    if view in (T_P, P_T):
        return (t, P, dt, 1.0) if view == T_P else (P, t, 1.0, dt)
    return (k, P, dk, 1.0) if view == K_P else (P, k, 1.0, dk)


def torque_and_stiffness(P, segment):
    """Return (t, k, t', k') at the pressure P."""
    if segment[0] == RATIONAL:
        r = 1 / (P + segment[1])
        square = r * r
        t, dt = segment[6] + segment[7] * P + segment[8] * r, segment[7] - segment[8] * square
        k, dk = segment[9] + segment[10] * P + segment[11] * r, segment[10] - segment[11] * square
    elif segment[0] == EXPONENTIAL:
        x = P / segment[2]
        E = exp(-x)
        one, two = E * (1 - x), E * E * (1 - 2 * x)
        t, dt = P * (segment[6] + E * (segment[7] + E * segment[8])), segment[6] + segment[7] * one + segment[8] * two
        k, dk = (
            P * (segment[9] + E * (segment[10] + E * segment[11])),
            segment[9] + segment[10] * one + segment[11] * two,
        )
    elif segment[0] == QUADRATIC:
        t, dt = segment[6] + P * (segment[7] + P * segment[8]), segment[7] + 2 * P * segment[8]
        k, dk = segment[9] + P * (segment[10] + P * segment[11]), segment[10] + 2 * P * segment[11]
    else:
        t, dt, _, _ = chebyshev(P, segment, 0)
        k, dk, _, _ = chebyshev(P, segment, 1)
    return t, k, dt, dk


def chebyshev(P, segment, which):
    """Return a Chebyshev series and its first three derivatives by P; `which`: 0 torque, 1 stiffness."""
    h, n = segment[2], int(segment[5])
    z, first = (P - segment[1]) / h, HEAD + which * n
    T, D, S, R = 1.0, 0.0, 0.0, 0.0  # T_j and its derivatives by z
    T1, D1, S1, R1 = z, 1.0, 0.0, 0.0  # T_j+1
    f = df = ddf = dddf = 0.0
    for j in range(n):
        c = segment[first + j]
        f, df, ddf, dddf = f + c * T, df + c * D, ddf + c * S, dddf + c * R
        T, T1, D, D1, S, S1, R, R1 = (
            *(T1, 2 * z * T1 - T, D1, 2 * T1 + 2 * z * D1 - D),
            *(S1, 4 * D1 + 2 * z * S1 - S, R1, 6 * S1 + 2 * z * R1 - R),
        )
    return f, df / h, ddf / (h * h), dddf / (h * h * h)


# --- pieces ---------------------------------------------------------------------------------------------------------


def pieces(curve, lo, hi, view):
    """Return the pieces of a curve from lo to hi, in the order of the pressures."""
    found: list[tuple[float, ...]] = []
    for s in range(len(curve)):
        segment = curve[s]
        a, b = max(lo, segment[3]), min(hi, segment[4])
        if a > b or (a == b and len(found) > 0):
            continue
        ends = [*cuts(segment, a, b, view > K_T), a, b]
        put_in_order(ends)
        for i in range(len(ends) - 1):
            if ends[i] < ends[i + 1] or len(ends) == 2:
                found.append(piece(s, segment, ends[i], ends[i + 1], view))
    return found


def put_in_order(values):
    """Sort a short list: numba compiles this in a tenth of the time of `sorted`."""
    for i in range(1, len(values)):
        value, j = values[i], i
        while j > 0 and value < values[j - 1]:
            values[j] = values[j - 1]
            j -= 1
        values[j] = value


def piece(s, segment, a, b, view):
    """Return the piece of a segment between two of its pressures."""
    return (float(s), a, b, *at(a, segment, view), *at(b, segment, view))


def cuts(segment, a, b, inflections):
    """Return the pressures between a and b at which t', k' or W vanishes, or with `inflections` t'' or k''."""
    if segment[0] == RATIONAL:
        turns = [turn(segment[7], segment[8], segment[1]), turn(segment[10], segment[11], segment[1])]
    elif segment[0] == EXPONENTIAL:
        h = segment[2]
        turns = [h * x for f in exponential_slopes(segment, inflections) for x in exponential_zeros(f, a / h, b / h)]
    elif segment[0] == QUADRATIC:  # W is constant
        turns = [-segment[i] / (2 * segment[i + 1]) for i in (7, 10) if segment[i + 1] != 0]
    else:
        turns = [P for what in range(5 if inflections else 3) for P in polynomial_zeros(segment, what, a, b)]
    return [P for P in turns if a < P < b]


def turn(f1, f2, d):
    """Return where f1 - f2/(P + d)² = 0 left of the pole; W has no zeros there. -d, which is right of it, for none."""
    return -d - sqrt(f2 / f1) if f1 * f2 > 0 else -d


# --- zeros of exponential laws, by Rolle's theorem ------------------------------------------------------------------


def exponential_slopes(segment, inflections):
    """Return t', k', W/E (and t''/E, k''/E) as Σ_j E^j q_j(x), x = P/h: the quadratics' coefficients in one row."""
    p0, p1, p2, q0, q1, q2 = segment[6], segment[7], segment[8], segment[9], segment[10], segment[11]
    M01, M02, M12 = p0 * q1 - p1 * q0, p0 * q2 - p2 * q0, p1 * q2 - p2 * q1
    found = [
        (p0, 0.0, 0.0, p1, -p1, 0.0, p2, -2 * p2, 0.0),
        (q0, 0.0, 0.0, q1, -q1, 0.0, q2, -2 * q2, 0.0),
        (-2 * M01, M01, 0.0, -4 * M02, 4 * M02, 0.0, -2 * M12, 3 * M12, -2 * M12),
    ]
    if inflections:
        found.append((-2 * p1, p1, 0.0, -4 * p2, 4 * p2, 0.0, 0.0, 0.0, 0.0))
        found.append((-2 * q1, q1, 0.0, -4 * q2, 4 * q2, 0.0, 0.0, 0.0, 0.0))
    return found


def exponential_zeros(f, a, b):
    """Return all zeros of an exponential's function between a and b: between two neighbours lies a zero of its
    derivative.

    The constant part vanishes after some derivatives and a factor E can then be left out, until a quadratic remains.
    """
    chain = []
    while f[3] != 0 or f[4] != 0 or f[5] != 0 or f[6] != 0 or f[7] != 0 or f[8] != 0:
        if f[0] == 0 and f[1] == 0 and f[2] == 0:
            f = (f[3], f[4], f[5], f[6], f[7], f[8], 0.0, 0.0, 0.0)
        else:
            chain.append(f)
            f = exponential_derivative(f)
    zeros = quadratic_zeros(f[0], f[1], f[2], a, b)
    for i in range(len(chain) - 1, -1, -1):
        zeros = exponential_between(chain[i], zeros, a, b)
    return zeros


def exponential_derivative(f):
    """Return d/dx Σ E^j q_j = Σ E^j (q_j' - j q_j)."""
    return (
        *(f[1], 2 * f[2], 0.0),
        *(f[4] - f[3], 2 * f[5] - f[4], -f[5]),
        *(f[7] - 2 * f[6], 2 * f[8] - 2 * f[7], -2 * f[8]),
    )


def exponential_value(f, x):
    """Return Σ E^j q_j(x)."""
    E = exp(-x)
    q0, q1, q2 = (f[0] + x * (f[1] + x * f[2]), f[3] + x * (f[4] + x * f[5]), f[6] + x * (f[7] + x * f[8]))
    return q0 + E * (q1 + E * q2)


def exponential_between(f, turns, a, b):
    """Return the zeros of f between a and b, of which there is at most one between neighbours of `turns`."""
    zeros, left, f_left = turns[:0], a, exponential_value(f, a)
    for right in [*turns, b]:
        f_right = exponential_value(f, right)
        if f_left * f_right < 0:
            u, fu, v, fv = left, f_left, right, f_right
            for i in range(_STEPS):
                x = next_guess(u, fu, v, fv, i)
                if abs(x - v) <= _NEAR * (right - left) or x == u:
                    break
                u, fu, v, fv = narrowed(u, fu, v, fv, x, exponential_value(f, x))
            zeros.append(v)
        left, f_left = right, f_right
    return zeros


def quadratic_zeros(c0, c1, c2, a, b):
    """Return the zeros of c0 + c1 x + c2 x² between a and b, rising."""
    square = c1 * c1 - 4 * c0 * c2
    s = -(c1 + (sqrt(square) if c1 > 0 else -sqrt(square))) / 2 if square >= 0 else 0.0
    one, two = s / c2 if c2 != 0 else b, c0 / s if s != 0 else b
    return [x for x in (min(one, two), max(one, two)) if a < x < b]


# --- zeros of polynomials, by bounds on their derivatives -----------------------------------------------------------


def polynomial_zeros(segment, what, a, b):
    """Return all zeros of t' (`what` = 0), k' (1), W (2), t'' (3) or k'' (4) of a Chebyshev segment, pressures from a
    to b.

    An interval is dropped if the function is too large in its middle to vanish in it, and has at most one zero if its
    derivative is; else it is halved. Zeros nearer to each other than `_FINEST` of the segment may be seen as one, and
    where the function is nothing but rounding it has none.
    """
    noise, zeros = _NOISE * polynomial_bound(segment, what, 0, a, b), [a][:0]
    if polynomial_bound(segment, what, 1, a, b) == 0:  # constant
        return zeros
    stack, h = [(a, b)], segment[2]
    while stack:
        u, v = stack.pop()
        half = (v - u) / 2
        f, df = polynomial_slope(segment, what, u + half)
        turn = polynomial_bound(segment, what, 2, u, v) * half  # by which the derivative may change
        if abs(f) > (abs(df) + turn / 2) * half:
            continue
        fu, fv = polynomial_slope(segment, what, u)[0], polynomial_slope(segment, what, v)[0]
        if half <= h / 8 and max(abs(f), abs(fu), abs(fv)) <= noise:
            continue
        if abs(df) >= turn or half < _FINEST * h:
            if fu * fv <= 0 and fu != fv:
                zeros.append(polynomial_zero(segment, what, u, fu, v, fv))
        else:
            stack.append((u, u + half))
            stack.append((u + half, v))
    return zeros


def polynomial_zero(segment, what, u, fu, v, fv):
    """Return the zero between u and v."""
    near = _NEAR * abs(v - u)
    for i in range(_STEPS):
        x = next_guess(u, fu, v, fv, i)
        if abs(x - v) <= near or x == u:
            break
        u, fu, v, fv = narrowed(u, fu, v, fv, x, polynomial_slope(segment, what, x)[0])
    return v


def polynomial_slope(segment, what, P):
    """Return (f, f') of f = t', k', W, t'' or k'' at P."""
    _, t1, t2, t3 = chebyshev(P, segment, 0)
    _, k1, k2, k3 = chebyshev(P, segment, 1)
    if what == 2:
        return t1 * k2 - t2 * k1, t1 * k3 - t3 * k1
    if what > 2:
        return (k2, k3) if what == 4 else (t2, t3)
    return (k1, k2) if what == 1 else (t1, t2)


def polynomial_bound(segment, what, order, u, v):
    """Return a bound between u and v on the derivative of an order (0: the function, 1, 2) of the same f."""
    t1, t2, t3, t4 = derivative_bounds(segment, 0, u, v)
    k1, k2, k3, k4 = derivative_bounds(segment, 1, u, v)
    if what == 2:
        return (t1 * k2 + t2 * k1, t1 * k3 + t3 * k1, t1 * k4 + t2 * k3 + t3 * k2 + t4 * k1)[order]
    bounds = (k1, k2, k3, k4) if what in (1, 4) else (t1, t2, t3, t4)
    return bounds[min(order + (1 if what > 2 else 0), 3)]


def derivative_bounds(segment, which, u, v):
    """Return the bounds on the first four derivatives by P of a Chebyshev series between u and v: Σ |c_j| |T_j^(m)|.

    Those of T_j are V. A. Markov's, T_j^(m)(1), or away from the ends of the segment what follows from |T_j| ≤ 1,
    S. Bernstein's |T_j'| ≤ j/√(1 - z²) and the derivatives of (1 - z²)T_j'' = zT_j' - j²T_j.
    """
    c, h, n = segment[1], segment[2], int(segment[5])
    z = min(max(abs(u - c), abs(v - c)) / h, 1.0)
    inner = max(1 - z * z, 1.0 / n**4)  # nearer to the ends Markov's are the lesser
    one = two = three = four = 0.0
    for j in range(1, n):
        size, square = abs(segment[HEAD + which * n + j]), float(j * j)
        T1 = min(square, j / sqrt(inner))
        T2 = min(square * (square - 1) / 3, (z * T1 + square) / inner)
        T3 = min(square * (square - 1) * (square - 4) / 15, (3 * z * T2 + abs(square - 1) * T1) / inner)
        T4 = min(square * (square - 1) * (square - 4) * (square - 9) / 105, (5 * z * T3 + abs(square - 4) * T2) / inner)
        one, two, three, four = one + size * T1, two + size * T2, three + size * T3, four + size * T4
    return one / h, two / h**2, three / h**3, four / h**4


# --- root finding ---------------------------------------------------------------------------------------------------


def next_guess(u, fu, v, fv, i):
    """Return where to look next for the root between u and v: regula falsi, and sometimes the middle."""
    if i % 8 == 7 or fu == fv:
        return u + (v - u) / 2
    x = v - fv * (v - u) / (fv - fu)
    return x if (u < x < v or v < x < u) else u + (v - u) / 2


def narrowed(u, fu, v, fv, x, fx):
    """Return (u, f(u), v, f(v)) with the root still between, v = x the latest.

    The Illinois rule halves a value kept twice.
    """
    if fx == 0:
        return x, fx, x, fx
    return (v, fv, x, fx) if fx * fv < 0 else (u, fu / 2, x, fx)


def pressure_at(X, arc, segment, view, P):
    """Return the pressure of a piece at which x = X, from the guess P; the nearer end of the piece beyond them."""
    a, b, xa, xb = arc[1], arc[2], arc[3], arc[7]
    rises = xb >= xa
    if (X <= xa) == rises or X == xa:
        return a
    if (X >= xb) == rises or X == xb:
        return b
    P = P if a < P < b else a + (X - xa) / (xb - xa) * (b - a)
    near = _NEAR * (b - a)
    for _ in range(_STEPS):
        x, _, dx, _ = at(P, segment, view)
        a, b = (a, P) if (x > X) == rises else (P, b)
        step = P - (x - X) / dx if dx != 0 else a
        if abs(step - P) <= near:
            return min(max(step, a), b)
        P = step if a < step < b else a + (b - a) / 2
        if P in (a, b):
            return P
    return P


FUNCTIONS: tuple[Callable[..., object], ...] = (
    *(at, torque_and_stiffness, chebyshev, pieces, put_in_order, piece, cuts, turn),
    *(exponential_slopes, exponential_zeros, exponential_derivative, exponential_value, exponential_between),
    *(quadratic_zeros, polynomial_zeros, polynomial_zero, polynomial_slope, polynomial_bound, derivative_bounds),
    *(next_guess, narrowed, pressure_at),
)
