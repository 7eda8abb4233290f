"""What a fitted joint leaves in doubt is said here: its covariance, the common force, forces and predicted angles."""
