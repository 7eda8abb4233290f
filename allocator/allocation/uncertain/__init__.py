"""Allocation for muscles whose parameters are known with a covariance."""
