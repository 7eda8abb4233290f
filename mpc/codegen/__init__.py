"""CasADi's expression graphs as text for compilers."""

__all__: list[str] = []
