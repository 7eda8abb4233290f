"""Environments in which arms with pneumatic muscles learn, on a compiled plant, many arms at a time."""

__all__: list[str] = []
