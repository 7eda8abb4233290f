"""Uncertainty of a fitted joint: covariance, common force, forces and predicted angles."""
