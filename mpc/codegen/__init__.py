"""Compilation: CasADi graphs printed as Python and C, and numba code that is kept on disk and called by address."""
