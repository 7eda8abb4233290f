"""Kinds and C text of plain Python expressions, given the variables of their function."""

import ast
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, NamedTuple, Protocol, Self, TypeAlias, get_args, get_origin, get_type_hints

import numpy as np

from allocator.compilation.printer.c_layout import (
    AND,
    ATOM,
    CHOICE,
    INT,
    LINK,
    LINKS,
    OR,
    REAL,
    SIDE,
    SIGNS,
    SUM,
    UNARY,
    compared,
    wrapped,
)
from allocator.compilation.printer.python_text import refuse

_OF_NUMBERS = {np.float64: REAL, np.int64: INT}  # otherwise `SIDE`


class ArrayKind(NamedTuple):
    """Element type of an array, and its sizes as C expressions."""

    element: str
    sizes: tuple[str, ...]
    constant: bool = False

    def argument(self, name: str) -> str:
        """Return the declaration of `name` as a pointer to such an array."""
        inner = "".join(f"[{size}]" for size in self.sizes[1:])
        return f"{'const ' * self.constant}{self.element} " + (f"(*{name}){inner}" if inner else f"*{name}")

    def memory(self, name: str) -> str:
        """Return the declaration of `name` as such an array."""
        return f"{self.element} {name}{''.join(f'[{size}]' for size in self.sizes)}"


class StructKind(NamedTuple):
    """Struct that replaces a named tuple: numbers, and arrays or pointers to them."""

    name: str
    fields: "Mapping[str, Kind]"
    holds: bool  # whether it holds the arrays, not pointers

    @classmethod
    def of(
        cls,
        record: type,
        name: str,
        sizes: Mapping[str, str],
        *,
        holds: bool = False,
        constant: bool = False,
        parts: "Mapping[type, Kind]" = MappingProxyType({}),
    ) -> Self:
        """Return the struct of a named tuple of numbers, arrays `Annotated` with their shapes, and other `parts`.

        `sizes` maps the names in shapes to C's. Arrays without a shape are left out.
        """
        fields: dict[str, Kind] = {}
        for field, hint in get_type_hints(record, include_extras=True).items():
            if get_origin(hint) is Annotated:
                array, *shape = get_args(hint)
                [element] = get_args(get_args(array)[-1]) or [get_args(array)[-1]]  # the latter from NumPy 2.5 on
                said = (re.sub(r"[A-Za-z_]\w*", lambda name: sizes[name[0]], str(size)) for size in shape)
                fields[field] = ArrayKind(_OF_NUMBERS.get(element, SIDE), tuple(said), constant)
            elif hint in (float, int) or hint in parts:
                fields[field] = parts.get(hint, REAL if hint is float else INT)
        return cls(name, fields, holds)

    def definition(self) -> str:
        """Return its typedef."""
        lines = [self.line(name, kind) for name, kind in self.fields.items()]
        return "\n".join(["typedef struct {", *(f"    {line};" for line in lines), f"}} {self.name};"])

    def line(self, name: str, kind: "Kind") -> str:
        """Return the declaration of a field."""
        if isinstance(kind, ArrayKind):
            return kind.memory(name) if self.holds else kind.argument(name)
        return f"{kind.name if isinstance(kind, StructKind) else kind} {name}"

    def argument(self, name: str) -> str:
        """Return the declaration of `name` as a pointer to it."""
        return f"{self.name} *{name}" if self.holds else f"const {self.name} *{name}"


class TupleKind(NamedTuple):
    """Struct that replaces a returned tuple of numbers."""

    name: str
    elements: tuple[str, ...]
    fields: tuple[str, ...]

    def definition(self) -> str:
        """Return its typedef."""
        fields = " ".join(f"{kind} {name};" for kind, name in zip(self.elements, self.fields, strict=True))
        return "\n".join(wrapped(f"typedef struct {{ {fields} }} {self.name};", 0))


class Constants(NamedTuple):
    """Tuple of constants that C has, which is not an argument there: the text and the kind of each."""

    elements: Sequence[tuple[str, str]]


Kind: TypeAlias = str | ArrayKind | StructKind | TupleKind | Constants
Kinds: TypeAlias = Mapping[str, Kind]
"""Kinds of arguments by name, the same in all functions."""


class Outside(NamedTuple):
    """C's counterparts of Python's names."""

    names: Mapping[str, str] = {}  # constants and functions that C has, by Python's name
    structs: Mapping[tuple[str, ...], str] = {}  # names of structs, by the returned names
    absent: Mapping[str, str] = {}  # when an argument counts as None
    usual: str = INT  # kind of the arguments that `Kinds` omits
    inner: str = "static"  # how functions that are not exported begin


def declared(name: str, kind: Kind) -> str:
    """Return the declaration of an argument or a variable; an array or a struct is a pointer to one."""
    if isinstance(kind, ArrayKind | StructKind):
        return kind.argument(name)
    return f"{kind.name if isinstance(kind, TupleKind) else kind} {name}"


_EMPTY, _ZEROS = "np.empty", "np.zeros"
_ELEMENTS = {"np.bool_": SIDE, "np.int8": SIDE}  # of new arrays; otherwise real


class Unit(Protocol):
    """Interface of a printing unit: the state shared by functions printed together."""

    outside: Outside
    nodes: dict[str, ast.FunctionDef]
    names: dict[str, object]
    entries: Mapping[str, str]
    comments: dict[str, dict[int, str]]  # by function and line

    def kind_of(self, argument: ast.arg) -> Kind:
        """Return the kind of an argument."""

    def returned(self, name: str) -> Kind:
        """Return the kind of a function's return value."""

    def literal(self, value: float) -> str:
        """Return the literal of a number."""

    def constant(self, node: ast.Name, kind: Kind = REAL) -> str:
        """Return the name of a global number, or of a global tuple of numbers for an argument of this kind."""


class Expressions:
    """Expressions of one function with arguments `known`, variables `local` and loop variables `loops`."""

    def __init__(self, unit: Unit, known: dict[str, Kind]) -> None:
        self.unit, self.known = unit, known
        self.local: dict[str, Kind] = {}
        self.loops: set[str] = set()  # variables of the loops around a statement
        self.made: set[str] = set()  # structs made of tuples; others are pointers

    # --- kinds

    def kind(self, node: ast.expr) -> Kind:
        """Return the kind of an expression."""
        match node:
            case ast.Constant(value):
                return REAL if isinstance(value, float) else INT
            case ast.Name(name):
                return self.of_name(name)
            case ast.Attribute(_, "size"):
                return INT
            case ast.Attribute(base, field):
                struct = self.kind(base)
                return struct.fields[field] if isinstance(struct, StructKind) else refuse(node, "no struct")
            case ast.Subscript(ast.Attribute(_, "shape"), _):
                return INT
            case ast.Subscript(array, place):
                return self.element(node, array, len(place.elts) if isinstance(place, ast.Tuple) else 1)
            case ast.BinOp(left, ast.Div() | ast.Pow(), right):
                return REAL
            case ast.IfExp(_, ast.Call() as left, _) if isinstance(self.kind(left), TupleKind):
                return self.kind(left)
            case ast.BinOp(left, _, right) | ast.IfExp(_, left, right):
                return self.either(left, right)
            case ast.UnaryOp(ast.USub(), operand):
                return self.kind(operand)
            case ast.Call(called, arguments):
                return self.of_call(called, arguments)
        return INT

    def of_name(self, name: str) -> Kind:
        """Return the kind of a variable or a constant."""
        if name in self.known or name in self.local:
            return self.known.get(name) or self.local[name]
        value = self.unit.names.get(name)
        if isinstance(value, tuple):
            return ArrayKind(REAL, (str(len(value)),), True)
        return REAL if isinstance(value, float) else INT

    def element(self, node: ast.expr, array: ast.expr, places: int) -> Kind:
        """Return the kind of an array's element, or of the subarray that fewer indices leave."""
        kind = self.kind(array)
        if not isinstance(kind, ArrayKind):
            refuse(node, "no array")
        if places < len(kind.sizes):
            return kind._replace(sizes=kind.sizes[places:])
        return REAL if kind.element == REAL else INT

    def of_call(self, called: ast.expr, arguments: Sequence[ast.expr]) -> Kind:
        """Return the kind of a call's value."""
        match called:
            case ast.Name(name) if name in ("sqrt", "ceil", *self.unit.outside.names):
                return REAL
            case ast.Name("abs" | "min" | "max"):
                return self.either(*arguments)
            case ast.Name(name) if name in self.unit.nodes:
                return self.unit.returned(name)
            case ast.Attribute(base, "copy"):
                return ArrayKind(REAL, self.sizes(base))
        if ast.unparse(called) in (_EMPTY, _ZEROS):
            shape = arguments[0].elts if isinstance(arguments[0], ast.Tuple) else arguments[:1]
            element = _ELEMENTS[ast.unparse(arguments[1])] if len(arguments) > 1 else REAL
            return ArrayKind(element, tuple(map(self.text, shape)))
        return INT

    def either(self, *nodes: ast.expr) -> str:
        """Return the kind of a number that is one of these or made of them."""
        return REAL if REAL in map(self.kind, nodes) else INT

    def sizes(self, node: ast.expr) -> tuple[str, ...]:
        """Return the sizes of an array."""
        kind = self.kind(node)
        return kind.sizes if isinstance(kind, ArrayKind) else refuse(node, "no array")

    def new_array(self, node: ast.expr) -> bool:
        """Return whether the value is a newly created array."""
        match node:
            case ast.Call(ast.Attribute(_, "copy"), []):
                return True
            case ast.Call(called, _):
                return ast.unparse(called) in (_EMPTY, _ZEROS)
        return False

    # --- text

    def text(self, node: ast.expr, least: int = 0) -> str:
        """Return an expression, in parentheses unless its operator binds at least as strongly as `least`."""
        text, level = self.expression(node)
        return text if level >= least else f"({text})"

    def expression(self, node: ast.expr) -> tuple[str, int]:
        """Return the text of an expression, and how strongly its operator binds."""
        match node:
            case ast.Constant(bool() | int() | float() as value):
                return self.unit.literal(value), ATOM
            case ast.Name(name):
                if name in self.made:
                    return f"&{name}", UNARY
                mine = name in self.known or name in self.local or name in self.loops
                return (name if mine else self.unit.constant(node)), ATOM
            case ast.Attribute(array, "size"):
                [size] = self.sizes(array)
                return size, ATOM
            case ast.Attribute():
                struct = isinstance(self.kind(node), StructKind)
                return ("&" * struct + self.member(node)), UNARY if struct else ATOM
            case ast.Subscript(ast.Attribute(array, "shape"), ast.Constant(int() as axis)):
                return self.sizes(array)[axis], ATOM
            case ast.Subscript(array, ast.Tuple(places)):
                return self.text(array, ATOM) + "".join(f"[{self.text(place)}]" for place in places), ATOM
            case ast.Subscript(array, place):
                return f"{self.text(array, ATOM)}[{self.text(place)}]", ATOM
            case ast.UnaryOp(ast.USub(), operand):
                inner = self.text(operand, UNARY)
                return (f"-({inner})" if inner.startswith("-") else f"-{inner}"), UNARY
            case ast.UnaryOp(ast.Invert(), operand):
                return f"~{self.text(operand, UNARY)}", UNARY
            case ast.UnaryOp(ast.Not(), operand):
                return f"!{self.truth(operand, UNARY)}", UNARY
            case ast.Call(called, arguments):
                return self.call(node, called, arguments), ATOM
        return self.combined(node)

    def truth(self, node: ast.expr, least: int = 0) -> str:
        """Return a truth value."""
        return self.text(node, least) if self.kind(node) == INT else refuse(node, "no truth value")

    def of_kind(self, kind: Kind, node: ast.expr, least: int = 0) -> str:
        """Return an expression, converted if it is an integer where a real number, or a tuple where a struct is due."""
        if isinstance(kind, StructKind) and isinstance(node, ast.Tuple):
            return f"&({kind.name}){self.braced(kind, node)}"
        if isinstance(kind, StructKind) and isinstance(node, ast.Name) and node.id not in {*self.known, *self.local}:
            return f"&{self.unit.constant(node, kind)}"
        if kind != REAL or self.kind(node) != INT:
            return self.text(node, least)
        match node:
            case ast.Constant(int() as value):
                return self.unit.literal(float(value))
            case ast.UnaryOp(ast.USub(), ast.Constant()):
                return f"-{self.of_kind(kind, node.operand)}"
        return f"({REAL}){self.text(node, UNARY)}"

    def braced(self, kind: StructKind, node: ast.Tuple) -> str:
        """Return the initialiser of a struct."""
        if len(kind.fields) != len(node.elts):
            refuse(node, f"{kind.name} is not unpacked into as many names")
        return f"{{{', '.join(map(self.of_kind, kind.fields.values(), node.elts))}}}"

    def combined(self, node: ast.expr) -> tuple[str, int]:
        """Return the text of several expressions with operators between."""
        kind = self.kind(node)
        match node:
            case ast.BinOp(left, ast.Pow(), right):
                return f"ANT_F(pow)({self.of_kind(REAL, left)}, {self.of_kind(REAL, right)})", ATOM
            case ast.BinOp(left, op, right) if type(op) in SIGNS:
                if isinstance(op, ast.BitOr) and kind != INT:
                    refuse(node, "no flags")
                sign, level = SIGNS[type(op)]
                return f"{self.of_kind(kind, left, level)} {sign} {self.of_kind(kind, right, level + 1)}", level
            case ast.Compare(ast.Name(name), [ast.Is()], [ast.Constant(None)]) if name in self.unit.outside.absent:
                return self.unit.outside.absent[name], LINK
            case ast.Compare(left, [op], [right]) if type(op) in LINKS:
                kind = self.either(left, right)
                one, other = (self.of_kind(kind, side, SUM) for side in (left, right))
                return compared(one, op, other, kind)
            case ast.BoolOp(op, values):
                sign, level = (" && ", AND) if isinstance(op, ast.And) else (" || ", OR)
                return sign.join(self.truth(value, LINK) for value in values), level
            case ast.IfExp(test, yes, no):
                return f"{self.truth(test, OR)} ? {self.of_kind(kind, yes, OR)} : {self.of_kind(kind, no, SUM)}", CHOICE
        refuse(node)

    def member(self, node: ast.Attribute) -> str:
        """Return the field of a struct, which is a variable or itself a field."""
        match node.value:
            case ast.Name(name):
                return f"{name}{'.' if name in self.made else '->'}{node.attr}"
            case ast.Attribute() as base:
                return f"{self.member(base)}.{node.attr}"
        refuse(node)

    def call(self, node: ast.Call, called: ast.expr, arguments: Sequence[ast.expr]) -> str:
        """Return a call."""
        name = ast.unparse(called)
        if name == "len":
            return self.sizes(arguments[0])[0]
        whole = "_int" if self.kind(node) == INT else ""
        made = {
            "abs": f"ant_abs{whole}",
            "min": f"ant_min{whole}",
            "max": f"ant_max{whole}",
            "sqrt": "ANT_F(sqrt)",
            "ceil": "ANT_F(ceil)",
            "int": "(int)",
            "np.isfinite": "isfinite",
            **self.unit.outside.names,
        }
        function = made.get(name) or (self.unit.entries.get(name, name) if name in self.unit.nodes else "")
        if not function or node.keywords:
            refuse(node, "C has no such function")
        kinds: Sequence[Kind] = [REAL if name in ("sqrt", "ceil") else self.kind(node)] * len(arguments)
        if name in self.unit.nodes:
            kinds = [self.unit.kind_of(argument) for argument in self.unit.nodes[name].args.args]
        if len(kinds) != len(arguments):
            refuse(node, "arguments are missing")
        return f"{function}({', '.join(map(self.of_kind, kinds, arguments))})"
