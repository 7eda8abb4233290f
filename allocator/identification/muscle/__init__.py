"""A muscle is found from measured forces here."""

__all__: list[str] = []
