"""Sizes of the structured QP of a joint; `mpc.tracking.compiled.arm.module` replaces the first line for an arm."""

JOINTS, NU, STIFFNESSES = 1, 2, 1  # joints n, muscles m, entries of svec K

NX, NY = 2 * JOINTS + NU, STIFFNESSES + NU  # entries of a state (q, ω, P), and of the outputs (svec K, F)
NXI = NX + NU  # of ξ = (δx, w)
BOUNDS, SUPPLY = 2 * NU, 4 * NU  # rows of a sample: those of the changes, and with those of the commands
FORCE = SUPPLY + 2 * JOINTS  # the first row of the forces; those of the joint ranges begin at SUPPLY
ALL = FORCE + NU
FREE, LOWER, UPPER = 0, -1, 1  # states of a change: free, or held at a bound
