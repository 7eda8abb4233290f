"""Devices are here: simulated ones, callables, Modbus, and how others add theirs."""

__all__: list[str] = []
