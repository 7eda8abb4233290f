"""Logs of joints whose truth is known, and the fits of them."""

from ....rigs.moving_joint import measured, slow_fit, slow_joint, swinging_fit, swinging_joint

__all__ = ["measured", "slow_fit", "slow_joint", "swinging_fit", "swinging_joint"]
