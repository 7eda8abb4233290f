"""Ordinary sample of the observer in one compiled call, from flat arrays to flat arrays."""
