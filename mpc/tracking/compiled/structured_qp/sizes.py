"""Sizes of the structured QP of a joint; `mpc.tracking.compiled.arm.module` replaces the first line for an arm."""

from math import isqrt

JOINTS, NU, STIFFNESSES = 1, 2, 1  # joints n, muscles m, entries of svec K

NX, NY = 2 * JOINTS + NU, STIFFNESSES + NU  # entries of a state (q, ω, P), and of the outputs (svec K, F)
NXI = NX + NU  # of ξ = (δx, w)
TRACKED = isqrt(2 * STIFFNESSES)  # rows of K
FREE, LOWER, UPPER = 0, -1, 1  # states of a change: free, or held at a bound of the slew
LOW, HIGH = -2, 2  # or with its command held at a bound of the supply
GONE, BOUND, SUPPLY, RANGE = -1, 0, 1, 2  # kinds of items: released; held at slew or supply; soft rows from here
FORCE = RANGE + 2 * JOINTS  # the first row of the forces
ALL = FORCE + NU
ROWS = ALL - RANGE  # soft rows of a sample
