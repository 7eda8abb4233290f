"""A joint from measured angles at rest."""

__all__: list[str] = []
