"""A muscle from measured forces."""

__all__: list[str] = []
