"""Printer of plain Python functions, such as the kernels of `source`, for NumPy and as C99.

NumPy's form and C have functions of numbers and tuples of numbers, in constructs that numba compiles without branches:

    Python                              NumPy                           C
    + - * / and | of flags              as it stands                    as it stands
    a if test else b                    np.where(test, a, b)            test ? a : b
    not a, a and b, a or b              np.logical_not(a), …            !a, a && b, a || b
    a < b < c                           np.logical_and(a < b, b < c)    a < b && b < c
    a if x is None else b               as it stands                    the test that stands for it
    if test: x = a                      x = np.where(test, a, x)        as it stands
    if test: return a                   the rest, where it is false     as it stands
    x, y, z = box                       as it stands                    fields of a struct, which has these names
    return x, y                         as it stands                    a struct of x and y
    for _ in range(4): …                as it stands                    a loop
    abs(x), sqrt(x), f(x)               np.abs(x), np.sqrt(x), f(x)     their names in C

C has functions that fill arrays as well, such as the solvers of `mpc`: see `to_c`. All other constructs raise
`Unprintable`.
"""

from allocator.compilation.printer.c_expressions import ArrayKind, Constants, Kind, Outside, StructKind
from allocator.compilation.printer.c_layout import INT, REAL, Printed, number
from allocator.compilation.printer.python_text import Unprintable, parsed, with_called
from allocator.compilation.printer.to_c import c_functions
from allocator.compilation.printer.to_numpy import array_functions

__all__ = [
    "INT", "REAL", "ArrayKind", "Constants", "Kind", "Outside", "Printed", "StructKind",
    "Unprintable", "array_functions", "c_functions", "number", "parsed", "with_called",
]  # fmt: skip
