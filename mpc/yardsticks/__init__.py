"""Yardsticks of the tracking controller: nonlinear MPC, feed-forward, PID, LQR."""
