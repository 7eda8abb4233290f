"""The room of the exact allocation in plain numbers holds one text, which is called, looped over, compiled and printed."""

__all__: list[str] = []
