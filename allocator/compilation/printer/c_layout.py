"""Operators and number types of C, and the layout of its text: lines of bounded width, comments in ASCII, literals."""

import ast
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from math import isinf
from typing import NamedTuple

import numpy as np

from allocator.compilation.printer.python_text import Source, assignments, refuse

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
CHOICE, OR, AND, FLAGS, LINK, SUM, UNARY, ATOM = 3, 4, 5, 6, 10, 12, 14, 16  # precedences; ATOM: no operator


WIDTH = 120
_ASCII = str.maketrans(
    {"θ": "theta", "ε": "eps", "τ": "tau", "κ": "kappa", "β": "beta", "·": "*", "²": "^2", "³": "^3", "±": "+-"}
    | {"≤": "<=", "≥": ">=", "`": "", "μ": "mu", "ᵀ": "^T", "‖": "|", "≈": "~", "Σ": "sum", "ω": "omega"}
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


def runs(pairs: Iterable[tuple[str, str]]) -> Iterator[tuple[str, list[str]]]:
    """Yield (key, values of all pairs in a row that begin with it)."""
    for key, group in groupby(pairs, key=lambda pair: pair[0]):
        yield key, [value for _, value in group]


def whole(text: str) -> str:
    """Return `text` marked so that `wrapped` keeps it in one line if it fits."""
    return text.replace(" ", "\0") if len(text) < WIDTH - 12 else text


def wrapped(line: str, depth: int) -> list[str]:
    """Return `line` broken at the line width."""
    first, later = "    " * depth, "    " * (depth + 1)
    width, options = WIDTH, {"break_long_words": False, "break_on_hyphens": False}
    lines = textwrap.wrap(line, width, initial_indent=first, subsequent_indent=later, **options)  # type: ignore[arg-type]  # both are bool
    return [line.replace("\0", " ") for line in lines]


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


MADE = {"inf": "ANT_INFINITY", "sqrt": "ANT_F(sqrt)", "abs": "ant_abs"}  # names that C always has


class Outside(NamedTuple):
    """C's counterparts of Python names, and of the arguments of the exported function `entry`."""

    names: Mapping[str, str] = {}  # constants and existing real functions, by Python's name
    functions: Mapping[str, str] = {}  # names of printed functions that differ from Python's
    structs: Mapping[tuple[str, ...], str] = {}  # names of structs, by their fields
    numbers: Mapping[str, Mapping[str, tuple[str, str]]] = {}  # a tuple's name: each element's type, and its text
    arrays: frozenset[str] = frozenset()  # tuples of `entry` that C has as arrays of real numbers
    flags: frozenset[str] = frozenset()  # arguments of `entry` that are ints
    absent: Mapping[str, str] = {}  # when an argument counts as None
    none: frozenset[str] = frozenset()  # arguments of `entry` that are always None
    inner: str = "static"  # how functions other than `entry` begin


class Text(NamedTuple):
    """Expression: its text, the kind of its value, and the precedence of its operator."""

    text: str
    kind: str
    level: int = ATOM

    def above(self, level: int) -> str:
        """Return it in parentheses unless its operator binds at least as strongly as `level`."""
        return self.text if self.level >= level else f"({self.text})"


def arguments_of(function: ast.FunctionDef) -> list[str]:
    """Return the names of the arguments of `function`."""
    return [argument.arg for argument in function.args.args]


def literal(value: float) -> Text:
    """Return the literal of `value`: an int without a point, a truth value as 0 or 1."""
    if isinstance(value, int):
        return Text(str(int(value)), INT)
    if isinf(value):
        return Text("ANT_INFINITY" if value > 0 else "(-ANT_INFINITY)", REAL)
    return Text(f"ANT_R({value!r})", REAL)


class Unit:
    """C file being printed: its structs, constants and functions by name."""

    def __init__(
        self,
        source: Source,
        outside: Outside,
        entry: str,
        write: Callable[["Unit", ast.FunctionDef, list[str]], None],
        printed: Sequence[str],
    ) -> None:
        self.source, self.outside, self.entry, self.printed = source, outside, entry, frozenset(printed)
        self.write = write  # prints a function into the unit
        self.comments = source.comments()
        self.fields = dict(self._unpacked(printed))  # fields of the struct, by the argument's name
        self.names: dict[str, list[str]] = {}  # fields of each struct
        self.kinds: dict[str, list[str]] = {}  # and their kinds
        self.structs: dict[str, str] = {}
        self.constants: dict[str, str] = {}
        self.heads: dict[str, str] = {}
        self.bodies: dict[str, str] = {}
        self.returns: dict[str, str] = {}
        self.taken: dict[str, list[str]] = {}  # kinds of a function's arguments

    def _unpacked(self, names: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
        for name in names:
            function = self.source.functions[name]
            for statement in ast.walk(function):
                if isinstance(statement, ast.Assign):
                    for target, value in assignments(statement):
                        if isinstance(target, ast.Tuple) and isinstance(value, ast.Name):
                            yield value.id, [e.id for e in target.elts if isinstance(e, ast.Name)]

    def given(self, name: str) -> str:
        """Return the kind of the argument `name` of the entry; "" for one that C omits."""
        if name in self.outside.none or name in self.outside.numbers:
            return ""
        if name in self.outside.arrays:
            return f"const {REAL} *"
        return INT if name in self.outside.flags else REAL

    def struct(self, node: ast.expr, name: str, fields: Sequence[str], kinds: Sequence[str], about: str) -> str:
        """Return the name of the struct with these fields; define it if there is none."""
        name = self.outside.structs.get(tuple(fields), name)
        if self.kinds.setdefault(name, list(kinds)) != list(kinds):
            refuse(node, f"{name} holds {kinds}, and {self.kinds[name]} elsewhere")
        self.names.setdefault(name, list(fields))
        lines = [f"    {kind} {', '.join(names)};" for kind, names in runs(zip(kinds, fields, strict=True))]
        self.structs.setdefault(name, "\n".join([f"/* {about} */", "typedef struct {", *lines, f"}} {name};"]))
        return name

    def function(self, name: str, kinds: list[str]) -> str:
        """Print the function `name` for arguments of these kinds, once; return the kind of its value."""
        if self.taken.setdefault(name, kinds) != kinds:
            refuse(self.source.functions[name], f"called with {kinds} and with {self.taken[name]}")
        if name not in self.returns:
            self.write(self, self.source.functions[name], kinds)
        return self.returns[name]

    def constant(self, node: ast.Name) -> Text:
        """Return the value of the global number `node`, or its name in C."""
        value, known = self.source.names.get(node.id), {**MADE, **self.outside.names}
        if not isinstance(value, int | float):
            refuse(node, "no number")
        return literal(value)._replace(text=known[node.id]) if node.id in known else literal(value)

    def constant_struct(self, node: ast.Name, name: str) -> Text:
        """Return the global tuple of numbers `node` as a constant struct, of the type of the argument `name`."""
        values = [literal(value) for value in self.source.names[node.id]]
        text = self.outside.names.get(node.id, f"{{{', '.join(value.text for value in values)}}}")
        kind = self.struct_of(node, name, values)
        self.constants[node.id] = f"static const {kind} {node.id} = {text};"
        return Text(node.id, kind)

    def struct_of(self, node: ast.expr, name: str, values: Sequence[Text]) -> str:
        """Return the struct of `values`, of the type of the argument `name`."""
        fields = self.fields.get(name, [])
        if len(fields) != len(values):
            refuse(node, f"{name} is not unpacked into as many names")
        kinds = [value.kind for value in values]
        return self.struct(node, f"ant_{name}", fields, kinds, f"Type of arguments called {name}.")

    def called(self, name: str) -> str:
        """Return the name in C of the function `name`."""
        return self.outside.functions.get(name, name)
