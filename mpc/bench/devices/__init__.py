"""Devices: simulated ones, functions, Modbus, serial lines, and entry points for others."""
