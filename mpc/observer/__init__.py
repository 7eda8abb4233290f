"""Estimation of the state, the load and the faults of a machine from its sensors."""
