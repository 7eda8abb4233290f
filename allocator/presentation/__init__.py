"""Results are shown to a person here: tables, pictures, sliders."""

__all__: list[str] = []
