"""The tracking controller of an arm is here: `mpc.tracking` with vectors where that has numbers."""

__all__: list[str] = []
