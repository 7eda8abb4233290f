"""Arms on MuJoCo: how well the MPC follows, what it costs, against IPOPT and against PIDs."""
