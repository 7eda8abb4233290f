"""Endpoint of a mechanism, a hand: its position, force and stiffness."""

from allocator.mechanism.endpoint.endpoint import Endpoint, hand_of_model

__all__ = ["Endpoint", "hand_of_model"]
