"""Identification of a moving joint from a log: lags, dead time, hysteresis, damping and inertia."""
