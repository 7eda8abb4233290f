"""Logs of joints whose truth is known, and the fits of them."""

from ....rigs.moving_joint import slow_fit, slow_joint, swinging_fit, swinging_joint

__all__ = ["slow_fit", "slow_joint", "swinging_fit", "swinging_joint"]
