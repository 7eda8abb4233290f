"""Kinds of values that functions of arrays have in C: numbers, arrays, structs for tuples."""

import ast
from collections.abc import Mapping
from typing import NamedTuple, TypeAlias

from allocator.compilation.printer.c_layout import INT, REAL


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
