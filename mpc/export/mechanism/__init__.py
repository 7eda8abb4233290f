"""Mechanisms are exported as C here: the allocation of many muscles' pressures on a microcontroller."""
