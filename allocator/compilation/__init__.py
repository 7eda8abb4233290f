"""Compiling with numba, and the cache of what was compiled."""
