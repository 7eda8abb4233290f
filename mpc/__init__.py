"""Dynamics and control of the antagonistic joint: plant, linear time-varying MPC, closed-loop simulation."""
