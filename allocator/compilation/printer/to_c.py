"""Printing of plain Python functions, such as the kernels of joints and mechanisms, as C99 without a heap.

They use constructs that numba compiles: numbers, arrays, tuples of these, loops over `range` and arrays, branches,
calls of each other, `abs`, `min`, `max`, `sqrt`, `len`, `isfinite`, new arrays of constant size, copies. Docstrings and
comments are kept. Array sizes are compile-time constants in C. `Kinds` gives the kind of an argument by its name, for
all functions; a tuple that a function unpacks into names is otherwise a struct with fields of these names, and other
arguments are numbers. Variables take the kind of their assigned values: real, an int (flags and truth values), a
struct, or a pointer to an array or a struct. All other constructs raise `Unprintable`. `Outside` lists C's counterparts
of names; real.h of the export has those that all printed functions need.
"""

import ast
from collections.abc import Iterator, Mapping, Sequence
from math import isinf

from allocator.compilation.jit import Function
from allocator.compilation.printer.c_expressions import Kind, Kinds, Outside, StructKind, TupleKind
from allocator.compilation.printer.c_layout import INT, REAL, Printed, number, wrapped
from allocator.compilation.printer.c_statements import Statements
from allocator.compilation.printer.python_text import comments, parsed, refuse


def c_functions(
    functions: Sequence[Function],
    kinds: Kinds,
    single: bool,
    entries: Mapping[str, str],
    numbers: Mapping[str, float],
    outside: Outside = Outside(),  # noqa: B008  # frozen
) -> Printed:
    """Return the C text of `functions`; `entries` maps the exported ones to their names in C.

    `numbers` has the C text of global names that differ from Python's value. Raises `Unprintable`.
    """
    unit = _Unit(functions, kinds, single, entries, numbers, outside)
    bodies = {name: unit.function(name) for name in unit.nodes}
    own = [_prototype(head) for name, head in unit.heads.items() if name not in entries]
    tuples = {name: kind for name, kind in unit.returns.items() if isinstance(kind, TupleKind)}
    shown = dict.fromkeys(tuples[name] for name in entries if name in tuples)
    inner = [kind for kind in dict.fromkeys(tuples.values()) if kind not in shown]
    head = [*(kind.definition() for kind in shown), *(_prototype(unit.heads[name]) for name in entries)]
    structs = (kind.definition() for kind in unit.structs.values())
    begin = "\n".join([*structs, *(kind.definition() for kind in inner), *unit.constants.values()])
    return Printed("\n".join(head), "\n\n".join(filter(None, [begin, "\n".join(own), *bodies.values()])))


def _prototype(head: str) -> str:
    return "\n".join(wrapped(f"{head};", 0))


class _Unit:
    """Functions being printed: their arguments and return kinds, and the structs and constants that they use."""

    def __init__(
        self,
        functions: Sequence[Function],
        kinds: Kinds,
        single: bool,
        entries: Mapping[str, str],
        numbers: Mapping[str, float],
        outside: Outside,
    ) -> None:
        self.single, self.entries, self.numbers, self.outside = single, entries, numbers, outside
        functions = [function for function in functions if function.__name__ not in outside.names]
        self.nodes = {node.name: node for node in map(parsed, functions)}
        self.comments = {function.__name__: comments(function) for function in functions}
        self.names: dict[str, object] = {}
        for f in functions:
            self.names |= getattr(f, "py_func", f).__globals__  # a global name means the same in all of them
        self.structs = {name: kind for name, kind in self._unpacked(kinds) if name not in kinds}
        self.kinds: Kinds = {**self.structs, **kinds}
        self.constants: dict[str, str] = {}  # definitions by name
        self.heads: dict[str, str] = {}
        self.returns: dict[str, Kind] = {}
        self._read: dict[str, Statements] = {}

    def _unpacked(self, kinds: Kinds) -> Iterator[tuple[str, StructKind]]:
        """Yield the arguments that are unpacked into names, as structs."""
        for function in self.nodes.values():
            arguments = {argument.arg for argument in function.args.args}
            for node in ast.walk(function):
                match node:
                    case ast.Assign([ast.Tuple(names)], ast.Name(name)) if name in arguments:
                        fields = [ast.unparse(one).lstrip("_") for one in names]
                        typed = {field: kinds.get(field, self.outside.usual) for field in fields}
                        yield name, StructKind(f"ant_{name}", typed, False)

    def kind_of(self, argument: ast.arg) -> Kind:
        """Return the kind of an argument: by its annotation `float`, else by its name, else the usual one."""
        real = isinstance(argument.annotation, ast.Name) and argument.annotation.id == "float"
        return REAL if real else self.kinds.get(argument.arg, self.outside.usual)

    def _of(self, name: str) -> Statements:
        """Return a function whose kinds are known."""
        if name not in self._read:
            self._read[name] = Statements(self, self.nodes[name])
        return self._read[name]

    def function(self, name: str) -> str:
        """Return the text of a function, and record its prototype."""
        made = self._of(name)
        text = "\n".join(made.lines())
        self.heads[name] = made.head
        return text

    def returned(self, name: str) -> Kind:
        """Return the kind of the function's return value, "void" for none."""
        if name not in self.returns:
            self.returns[name] = INT  # placeholder against recursion
            self.returns[name] = self._of(name).result()
        return self.returns[name]

    def literal(self, value: float) -> str:
        """Return a number."""
        return str(int(value)) if isinstance(value, int) else number(value, self.single)

    def constant(self, node: ast.Name, kind: Kind = REAL) -> str:
        """Define a global number or tuple of numbers, and return its name."""
        value, name = self.numbers.get(node.id, self.names.get(node.id)), f"ANT_{node.id.lstrip('_')}"
        if isinstance(value, int | float):
            if node.id in self.outside.names or isinf(value):
                return self.outside.names.get(node.id, f"({self.literal(value)})")
            self.constants[name] = f"#define {name} {self.literal(value)}"
        elif isinstance(value, tuple) and all(isinstance(element, int | float) for element in value):
            said = self.outside.names.get(node.id, f"{{{', '.join(map(self.literal, value))}}}")
            form = f"{kind.name} {name}" if isinstance(kind, StructKind) else f"{REAL} {name}[]"
            self.constants[name] = "\n".join(wrapped(f"static const {form} = {said};", 0))
        else:
            refuse(node, "no number")
        return name
