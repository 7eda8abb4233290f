"""Friction in a joint and its hysteresis: loads and models."""
