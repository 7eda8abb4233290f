"""A whole sample of a control loop is made in one compiled call here, from flat arrays to flat arrays."""
