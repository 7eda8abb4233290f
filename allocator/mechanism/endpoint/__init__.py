"""Endpoint of a mechanism, a hand: its position, force and stiffness."""

from allocator.mechanism.endpoint.endpoint import Endpoint

__all__ = ["Endpoint"]
