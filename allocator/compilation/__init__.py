"""Compilation with numba, and the cache of compiled code."""
