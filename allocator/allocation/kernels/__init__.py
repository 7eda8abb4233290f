"""Kernels are the exact allocation in plain numbers: one text, called for a target, looped over arrays, compiled."""

__all__: list[str] = []
