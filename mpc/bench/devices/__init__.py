"""Devices are here: simulated ones, callables, Modbus, and how others add theirs."""
