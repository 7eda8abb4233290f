"""Bodies and tendons beyond a planar chain: trees of hinges in space, and mechanics that only MuJoCo computes."""
