"""Compiled motion of an arm over a sample, for controllers and observers."""
