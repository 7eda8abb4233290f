"""Is `allocate` exact for every muscle model on every geometry, and how long does it take there?

The joints, the dense search and the verdict are those of `tests.exact_everywhere`; here they see many more targets.
"""
