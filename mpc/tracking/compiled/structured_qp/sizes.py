"""Sizes of the structured QP of a joint; `mpc.tracking.compiled.arm.module` replaces the first line for an arm."""

from math import isqrt

JOINTS, NU, STIFFNESSES, MOVING = 1, 2, 1, 4  # joints n, muscles m, entries of svec K, entries of a state in A

NX, NY = 2 * JOINTS + NU, STIFFNESSES + NU  # entries of a state (q, ω, P), and of the outputs (svec K, F)
NXI = NX + NU  # of ξ = (δx, w)
TRACKED = isqrt(2 * STIFFNESSES)  # rows of K
FREE, LOWER, UPPER = 0, -1, 1  # states of a change: free, or held at a bound of the slew
LOW, HIGH = -2, 2  # or with its command held at a bound of the supply
GONE, BOUND, SUPPLY, RANGE = -1, 0, 1, 2  # kinds of items: released; held at slew or supply; soft rows from here
FORCE = RANGE + 2 * JOINTS  # the first row of the forces
ALL = FORCE + NU
SIDES = 4  # of a change: below and above its slew and its supply


def limit_lines(n: int, m: int) -> int:
    """Return the number of lines for the limits of a sample, as many to a line as there are muscles."""
    return SIDES - (-(2 * n + m) // m)


def spare(n: int, m: int) -> int:
    """Return the number of items beyond the changes of a step: both slacks, a row for each of them, and the entering
    one; at least, with a single block, the lines of the barrier and its responses to both slacks.
    """
    return max(5, limit_lines(n, m) + 2 - m)


LIMIT_LINES, SPARE = limit_lines(JOINTS, NU), spare(JOINTS, NU)
