"""Measured stiffness: tones on a device, their evaluation, and updates of files."""
