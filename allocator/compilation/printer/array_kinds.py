"""Kinds of values that functions of arrays have in C: numbers, arrays, structs for tuples."""

from collections.abc import Mapping
from typing import NamedTuple, TypeAlias


class ArrayKind(NamedTuple):
    """An `ArrayKind` is what an array holds, and its sizes as C has them."""

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
    """Struct in the place of a named tuple: of numbers and of arrays, or of pointers to them."""

    name: str
    fields: "Mapping[str, Kind]"
    holds: bool  # whether the arrays are in it

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
    """A `TupleKind` is what a function returns that returns several numbers."""

    name: str
    elements: tuple[str, ...]

    def definition(self) -> str:
        """Return its typedef."""
        fields = " ".join(f"{kind} _{i};" for i, kind in enumerate(self.elements))
        return f"typedef struct {{ {fields} }} {self.name};"


Kind: TypeAlias = str | ArrayKind | StructKind | TupleKind
Kinds: TypeAlias = Mapping[str, Kind]
"""What the arguments of a name are, in all functions: arrays and structs; what is not here is an int."""


def declared(name: str, kind: Kind) -> str:
    """Return the declaration of an argument or a variable; an array or a struct is a pointer to one."""
    if isinstance(kind, str):
        return f"{kind} {name}"
    return f"{kind.name} {name}" if isinstance(kind, TupleKind) else kind.argument(name)
