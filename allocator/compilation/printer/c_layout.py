"""Operators and number types of C, and the layout of its text: lines of bounded width, comments in ASCII, literals."""

import ast
import math
import textwrap
from typing import NamedTuple

import numpy as np

REAL, INT, SIDE = "ant_real", "int", "signed char"
LINKS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
SIGNS = {
    ast.Add: ("+", 12),
    ast.Sub: ("-", 12),
    ast.Mult: ("*", 13),
    ast.Div: ("/", 13),
    ast.FloorDiv: ("/", 13),
    ast.BitOr: ("|", 6),
    ast.BitAnd: ("&", 8),
    ast.LShift: ("<<", 11),
    ast.RShift: (">>", 11),
}
KEYWORDS = {
    "auto", "case", "char", "const", "default", "do", "double", "enum", "extern", "float", "goto", "inline", "int",
    "long", "register", "restrict", "short", "signed", "sizeof", "static", "struct", "switch", "typedef", "union",
    "unsigned", "void", "volatile", "_Bool", "_Complex", "_Imaginary",
}  # fmt: skip  # of C99, less those that are also Python's
CHOICE, OR, AND, FLAGS, LINK, SUM, UNARY, ATOM = 3, 4, 5, 6, 10, 12, 14, 16  # precedences; ATOM: no operator


WIDTH = 120
_ASCII = str.maketrans(
    {"θ": "theta", "ε": "eps", "τ": "tau", "κ": "kappa", "β": "beta", "·": "*", "²": "^2", "³": "^3", "±": "+-"}
    | {"≤": "<=", "≥": ">=", "`": "", "μ": "mu", "ᵀ": "^T", "‖": "|", "≈": "~", "Σ": "sum", "ω": "omega"}
    | {"σ": "sigma", "ξ": "xi", "∂": "d", "…": "..."}
)


class Printed(NamedTuple):
    """C text of functions, for a header and for a file."""

    head: str  # structs, and prototypes of exported functions
    body: str


def compared(left: str, op: ast.cmpop, right: str, kind: object) -> tuple[str, int]:
    """Return a comparison, and how strongly its operator binds; real numbers are compared for equality by a function,
    because compilers warn about the operator.
    """
    if kind != REAL or not isinstance(op, ast.Eq | ast.NotEq):
        return f"{left} {LINKS[type(op)]} {right}", LINK
    equal = f"ant_equal({left}, {right})"
    return (equal, ATOM) if isinstance(op, ast.Eq) else (f"!{equal}", UNARY)


def wrapped(line: str, depth: int) -> list[str]:
    """Return `line` broken at the line width."""
    first, later = "    " * depth, "    " * (depth + 1)
    width, options = WIDTH, {"break_long_words": False, "break_on_hyphens": False}
    return textwrap.wrap(line, width, initial_indent=first, subsequent_indent=later, **options)  # type: ignore[arg-type]  # both are bool


def comment(text: str, depth: int) -> str:
    """Return `text` as a comment; indented lines keep their layout."""
    indent = "    " * depth
    lines: list[str] = []
    for paragraph in text.translate(_ASCII).split("\n\n"):
        kept = paragraph.startswith(" ")
        lines += ["", *(paragraph.split("\n") if kept else textwrap.wrap(paragraph, WIDTH - 6 - len(indent)))]
    between = f"\n{indent} * "
    return f"{indent}/* {between.join(lines[1:])} */".replace(" \n", "\n")


def number(value: float, single: bool) -> str:
    """Return the literal of `value`: all its digits, with suffix `f` in single precision.

    A value not finite, or outside single precision, becomes a macro of real.h.
    """
    with np.errstate(over="ignore"):
        rounded = np.float32(value) if single else np.float64(value)
    if math.isnan(rounded):
        return "ANT_NAN"
    if math.isinf(rounded):
        return "ANT_INFINITY" if rounded > 0 else "-ANT_INFINITY"
    return f"{rounded!s}f" if single else repr(float(rounded))
