"""Tuning of a control loop for one fitted plant: draws from its posterior, closed-loop cost, search."""
