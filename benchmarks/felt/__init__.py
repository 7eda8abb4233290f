"""Felt stiffness: allocated, predicted, measured. `python -m benchmarks.felt` lists the parts."""
