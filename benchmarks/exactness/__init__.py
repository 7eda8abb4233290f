"""Exactness and times of `allocate` for every muscle model on every geometry.

The joints, the dense search and the verdict are those of `tests.exact_everywhere`, with many more targets.
"""
