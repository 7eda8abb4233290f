"""Arms on MuJoCo: plants, pictures, films, learning. The model that controllers predict with is `mpc.model.arm`."""
