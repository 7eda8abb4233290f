"""Pressures are allocated here where the muscles' parameters are known with a covariance only."""
