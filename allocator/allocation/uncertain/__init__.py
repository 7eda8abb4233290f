"""Allocation for muscle parameters with a covariance."""
