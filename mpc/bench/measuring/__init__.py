"""Measured stiffness: tones on a device, what they say of the muscles, and files that keep it."""
