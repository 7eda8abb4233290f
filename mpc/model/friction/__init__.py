"""Friction in a joint, and the hysteresis that it makes: its load, and its models."""
