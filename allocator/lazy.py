"""Types of libraries that are imported only when they are used, for annotations in quotes."""

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    import casadi
    import matplotlib.axes
    import matplotlib.figure
    import rich.console
    import rich.table

Axes: TypeAlias = "matplotlib.axes.Axes"
Figure: TypeAlias = "matplotlib.figure.Figure"
Function: TypeAlias = "casadi.Function"
SX: TypeAlias = "casadi.SX"
Console: TypeAlias = "rich.console.Console"
Table: TypeAlias = "rich.table.Table"
