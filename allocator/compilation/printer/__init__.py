"""Printer of plain Python functions, such as the kernels of `source`, for NumPy and as C99.

Such functions use numbers and tuples of numbers, and the constructs that numba compiles into code without branches:

    Python                              NumPy                           C
    + - * / and | of flags              as it stands                    as it stands
    a if test else b                    np.where(test, a, b)            test ? a : b
    not a, a and b, a or b              np.logical_not(a), …            !a, a && b, a || b
    a < b < c                           np.logical_and(a < b, b < c)    a < b && b < c
    a if x is None else b               as it stands                    the test that stands for it, or a or b alone
    if test: x = a                      x = np.where(test, a, x)        as it stands
    if test: return a                   the rest, where it is false     as it stands
    x, y, z = box                       as it stands                    fields of a struct, which has these names
    return x, y                         as it stands                    a struct of x and y
    for _ in range(4): …                as it stands                    a loop
    abs(x), sqrt(x), f(x)               np.abs(x), np.sqrt(x), f(x)     their names in C

All other constructs raise `Unprintable`, in either form.

`c_functions` prints functions that fill arrays, such as the solvers of `mpc`: see `arrays_to_c`.

In C a variable is real, an int (flags and truth values) or a struct, by the value assigned to it.
"""

from allocator.compilation.printer.array_expressions import ArrayKind, Kind, StructKind
from allocator.compilation.printer.arrays_to_c import MIN_AND_MAX, c_functions, parsed, with_called
from allocator.compilation.printer.c_layout import INT, REAL, Outside, Printed, number
from allocator.compilation.printer.python_text import Source, Unprintable
from allocator.compilation.printer.to_c import c_form
from allocator.compilation.printer.to_numpy import array_form, array_functions

__all__ = [
    "INT", "MIN_AND_MAX", "REAL", "ArrayKind", "Kind", "Outside", "Printed", "Source", "StructKind", "Unprintable",
    "array_form", "array_functions", "c_form", "c_functions", "number", "parsed", "with_called",
]  # fmt: skip
