"""Closed loops are tried here: references, simulation, metrics, files and pictures."""

__all__: list[str] = []
