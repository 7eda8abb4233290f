"""Closed loops on trial: references, simulation, metrics, files and pictures."""

__all__: list[str] = []
