"""Allocation for the two muscles of a joint: closed forms, kernels and the complete search."""
