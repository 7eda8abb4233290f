"""Bodies and tendons beyond a chain in the plane are here: trees of hinges in space, and what only MuJoCo knows."""
