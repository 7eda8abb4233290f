"""The tracking controller of an arm: what `mpc.tracking` is for a joint, with vectors where that has numbers."""

__all__: list[str] = []
