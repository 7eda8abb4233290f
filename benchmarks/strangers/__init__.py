"""Joints that others have built: the controllers are tried on them."""
