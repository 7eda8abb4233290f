"""The yardsticks are what the tracking controller is measured against: nonlinear MPC, feed-forward, PID, LQR."""
