"""The controller's step is compiled here by numba; nothing of it is imported before it is needed, nor numba with it."""

__all__: list[str] = []
