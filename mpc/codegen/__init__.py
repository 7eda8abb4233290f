"""Compilation: CasADi graphs printed as Python and C, and numba code cached on disk and called by address."""
