"""Arms are mechanisms that move: rigid bodies, their model, an MPC of all pressures, and what it is tried on."""

__all__: list[str] = []
