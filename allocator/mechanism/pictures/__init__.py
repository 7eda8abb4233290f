"""Mechanisms are drawn here: what they can do, their arms and muscles, and the stiffness of their hands."""

from allocator.mechanism.pictures.arm import plot_arm
from allocator.mechanism.pictures.polygons import plot_polygon
from allocator.mechanism.pictures.workspace import plot_workspace

__all__ = ["plot_arm", "plot_polygon", "plot_workspace"]
