"""Functions are compiled with numba here, and what has been compiled is kept."""
