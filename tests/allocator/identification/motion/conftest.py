"""Logs of joints whose truth is known."""

from ....rigs.moving_joint import slow_joint, swinging_joint

__all__ = ["slow_joint", "swinging_joint"]
