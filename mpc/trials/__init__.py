"""Closed loops are tried here: references, simulation, metrics, files and pictures."""
