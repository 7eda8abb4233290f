"""How results show themselves to a person: tables, pictures, sliders."""

__all__: list[str] = []
