"""Back-ends solve the allocation problem by general optimisation."""

__all__: list[str] = []
