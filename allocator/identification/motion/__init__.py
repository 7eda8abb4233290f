"""A moving joint is identified from a log here: lags, dead time, hysteresis, and what the motion shows of inertia."""
