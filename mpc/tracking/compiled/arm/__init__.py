"""The compiled step of an arm says what `mpc.arm`'s readable one says, some ten times as fast."""

__all__: list[str] = []
