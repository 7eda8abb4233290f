"""Arms on MuJoCo: tracking errors and times of the MPC, against IPOPT and PIDs."""
