"""Environments for reinforcement learning with pneumatic arms, many at a time on a compiled plant."""
