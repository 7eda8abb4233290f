"""Explorer: a page in the browser with a joint, its pressures and its feasible stiffnesses, computed by `allocate`."""
