"""Bodies and tendons beyond those of a chain in the plane: trees of hinges in space, and what only MuJoCo knows."""

__all__: list[str] = []
