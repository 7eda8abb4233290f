"""The QP of a step: condensed, solved, and its solution proved."""

__all__: list[str] = []
