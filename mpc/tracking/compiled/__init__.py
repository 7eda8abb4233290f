"""The controller's step compiled by numba; nothing here is imported before it is wanted, nor numba with it."""

__all__: list[str] = []
