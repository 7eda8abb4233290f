"""This room has bodies and tendons beyond a chain in the plane: trees of hinges in space, and what only MuJoCo knows."""

__all__: list[str] = []
