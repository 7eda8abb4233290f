"""Kinds and C text of plain Python expressions, given the variables of their function."""

import ast
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, TypeAlias

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
)
from allocator.compilation.printer.python_text import refuse


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

    def definition(self) -> str:
        """Return its typedef."""
        fields = " ".join(f"{kind} _{i};" for i, kind in enumerate(self.elements))
        return f"typedef struct {{ {fields} }} {self.name};"


Kind: TypeAlias = str | ArrayKind | StructKind | TupleKind
Kinds: TypeAlias = Mapping[str, Kind]
"""Kinds of arguments by name, the same in all functions: arrays and structs; others are ints."""


def declared(name: str, kind: Kind) -> str:
    """Return the declaration of an argument or a variable; an array or a struct is a pointer to one."""
    if isinstance(kind, str):
        return f"{kind} {name}"
    return f"{kind.name} {name}" if isinstance(kind, TupleKind) else kind.argument(name)


def kind_of(argument: ast.arg, kinds: Kinds) -> Kind:
    """Return the kind of an argument: by its annotation `float`, else by its name, else an integer."""
    real = isinstance(argument.annotation, ast.Name) and argument.annotation.id == "float"
    return REAL if real else kinds.get(argument.arg, INT)


_EMPTY, _ZEROS = "np.empty", "np.zeros"
_ELEMENTS = {"np.bool_": SIDE, "np.int8": SIDE}  # of new arrays; otherwise real


class Unit(Protocol):
    """Interface of a printing unit: the state shared by functions printed together."""

    kinds: Kinds
    nodes: dict[str, ast.FunctionDef]
    names: dict[str, object]
    entries: Mapping[str, str]

    def returned(self, name: str) -> Kind:
        """Return the kind of a function's return value."""

    def literal(self, value: float) -> str:
        """Return the literal of a number."""

    def constant(self, node: ast.Name) -> str:
        """Return the name of a global number."""


class Expressions:
    """Expressions of one function with arguments `known`, variables `local` and loop variables `loops`."""

    def __init__(self, unit: Unit, known: dict[str, Kind], loops: set[str]) -> None:
        self.unit, self.known, self.loops = unit, known, loops
        self.local: dict[str, Kind] = {}

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
            case ast.Name("sqrt" | "ceil"):
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
                return f"-{self.text(operand, UNARY)}", UNARY
            case ast.UnaryOp(ast.Invert(), operand):
                return f"~{self.text(operand, UNARY)}", UNARY
            case ast.UnaryOp(ast.Not(), operand):
                return f"!{self.text(operand, UNARY)}", UNARY
            case ast.Call(called, arguments):
                return self.call(node, called, arguments), ATOM
        return self.combined(node)

    def of_kind(self, kind: Kind, node: ast.expr, least: int = 0) -> str:
        """Return an expression, converted if it is an integer where a real number is required."""
        if kind != REAL or self.kind(node) != INT:
            return self.text(node, least)
        match node:
            case ast.Constant(int() as value):
                return self.unit.literal(float(value))
            case ast.UnaryOp(ast.USub(), ast.Constant()):
                return f"-{self.of_kind(kind, node.operand)}"
        return f"({REAL}){self.text(node, UNARY)}"

    def combined(self, node: ast.expr) -> tuple[str, int]:
        """Return the text of several expressions with operators between."""
        kind = self.kind(node)
        match node:
            case ast.BinOp(left, ast.Pow(), right):
                return f"ANT_F(pow)({self.of_kind(REAL, left)}, {self.of_kind(REAL, right)})", ATOM
            case ast.BinOp(left, op, right) if type(op) in SIGNS:
                sign, level = SIGNS[type(op)]
                return f"{self.of_kind(kind, left, level)} {sign} {self.of_kind(kind, right, level + 1)}", level
            case ast.Compare(left, [op], [right]) if type(op) in LINKS:
                kind = self.either(left, right)
                one, other = (self.of_kind(kind, side, SUM) for side in (left, right))
                return compared(one, op, other, kind)
            case ast.BoolOp(op, values):
                sign, level = (" && ", AND) if isinstance(op, ast.And) else (" || ", OR)
                return sign.join(self.text(value, LINK) for value in values), level
            case ast.IfExp(test, yes, no):
                return f"{self.text(test, OR)} ? {self.of_kind(kind, yes, OR)} : {self.of_kind(kind, no, SUM)}", CHOICE
        refuse(node)

    def member(self, node: ast.Attribute) -> str:
        """Return the field of a struct, which is a variable or itself a field."""
        match node.value:
            case ast.Name(name):
                return f"{name}->{node.attr}"
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
        }
        function = made.get(name) or (self.unit.entries.get(name, name) if name in self.unit.nodes else "")
        if not function or node.keywords:
            refuse(node, "C has no such function")
        kinds: Sequence[Kind] = [REAL if name in ("sqrt", "ceil") else self.kind(node)] * len(arguments)
        if name in self.unit.nodes:
            kinds = [kind_of(argument, self.unit.kinds) for argument in self.unit.nodes[name].args.args]
        return f"{function}({', '.join(map(self.of_kind, kinds, arguments))})"
