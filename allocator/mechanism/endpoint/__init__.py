"""An endpoint is a hand, which exerts a force, and has a stiffness or shall have one."""

from allocator.mechanism.endpoint.endpoint import Endpoint

__all__ = ["Endpoint"]
