"""Compiling functions with numba, and keeping what has been compiled."""

__all__: list[str] = []
