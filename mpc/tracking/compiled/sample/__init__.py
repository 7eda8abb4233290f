"""Whole sample of a control loop in one compiled call, from flat arrays to flat arrays."""
