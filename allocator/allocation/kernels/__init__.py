"""The exact allocation in plain numbers: one text, called for one target, looped over arrays, compiled."""

__all__: list[str] = []
