"""Printing of plain Python functions that fill arrays, such as the kernel of mechanisms, as C99 without a heap.

They use constructs that numba compiles: numbers, arrays, named tuples of these, loops over `range` and arrays,
branches, calls of each other, `abs`, `min`, `max`, `sqrt`, `len`, `isfinite`, new arrays of constant size, copies. A
named tuple becomes a struct; array sizes are compile-time constants in C. `Kinds` gives the kind of an argument by its
name, for all functions. Other variables take the kind of their assigned values: real, or a pointer to an array or a
struct. All other constructs raise `Unprintable`.
"""

import ast
import inspect
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from inspect import isbuiltin

from allocator.compilation.jit import Function
from allocator.compilation.printer.array_expressions import (
    ArrayKind,
    Expressions,
    Kind,
    Kinds,
    StructKind,
    TupleKind,
    declared,
    kind_of,
)
from allocator.compilation.printer.c_layout import (
    ATOM,
    INT,
    REAL,
    SIDE,
    SIGNS,
    SUM,
    UNARY,
    Printed,
    comment,
    number,
    wrapped,
)  # fmt: skip
from allocator.compilation.printer.python_text import Unprintable, refuse, simplified

MIN_AND_MAX = "\n".join(
    f"static inline {kind} ant_{name}{suffix}({kind} a, {kind} b) {{ return b {sign} a ? b : a; }}"
    for kind, suffix in ((REAL, ""), (INT, "_int"))
    for name, sign in (("min", "<"), ("max", ">"))
)
"""Definitions of min and max, NaN included, to be placed before printed functions."""


def c_functions(
    functions: Sequence[Function],
    kinds: Kinds,
    single: bool,
    entries: Mapping[str, str],
    numbers: Mapping[str, float],
) -> Printed:
    """Return the C text of `functions`; `entries` maps the exported ones to their names in C.

    `numbers` has the C text of global names that differ from Python's value. Raises `Unprintable`.
    """
    unit = _Unit(functions, kinds, single, entries, numbers)
    bodies = [unit.function(function.__name__) for function in functions]
    heads = {name: unit.heads[name] for name in unit.heads}
    own = [_prototype(head) for name, head in heads.items() if name not in entries]
    tuples = {name: kind.definition() for name, kind in unit.returns.items() if isinstance(kind, TupleKind)}
    head = "\n".join(
        [*(tuples.pop(name) for name in entries if name in tuples), *(_prototype(heads[n]) for n in entries)]
    )
    begin = "\n".join([*unit.constants.values(), *tuples.values()])
    return Printed(head, "\n\n".join([begin, "\n".join(own), *bodies]))


def _prototype(head: str) -> str:
    return "\n".join(wrapped(f"{head};", 0))


class _Unit:
    """Functions being printed: their return kinds, and the constants that they use."""

    def __init__(
        self,
        functions: Sequence[Function],
        kinds: Kinds,
        single: bool,
        entries: Mapping[str, str],
        numbers: Mapping[str, float],
    ) -> None:
        self.kinds, self.single, self.entries, self.numbers = kinds, single, entries, numbers
        self.nodes = {node.name: node for node in map(parsed, functions)}
        self.names: dict[str, object] = {}
        for f in functions:
            self.names |= getattr(f, "py_func", f).__globals__  # a global name means the same in all of them
        self.constants: dict[str, str] = {}  # definitions by name
        self.heads: dict[str, str] = {}
        self.returns: dict[str, Kind] = {}
        self._read: dict[str, _Function] = {}

    def _of(self, name: str) -> "_Function":
        """Return a function whose kinds are known."""
        if name not in self._read:
            self._read[name] = _Function(self, self.nodes[name])
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

    def constant(self, node: ast.Name) -> str:
        """Define a global number or tuple of numbers, and return its name."""
        value, name = self.numbers.get(node.id, self.names.get(node.id)), f"ANT_{node.id}"
        if isinstance(value, int | float):
            self.constants[name] = f"#define {name} {self.literal(value)}"
        elif isinstance(value, tuple) and all(isinstance(element, float) for element in value):
            listed = ", ".join(map(self.literal, value))
            self.constants[name] = "\n".join(wrapped(f"static const {REAL} {name}[] = {{{listed}}};", 0))
        else:
            refuse(node, "no number")
        return name


class _Function(Expressions):
    """One function, line by line."""

    def __init__(self, unit: _Unit, node: ast.FunctionDef) -> None:
        known = {argument.arg: kind_of(argument, unit.kinds) for argument in node.args.args}
        nodes = [*ast.walk(node)]
        loops = {n.target.id for n in nodes if isinstance(n, ast.For) and isinstance(n.target, ast.Name)}
        super().__init__(unit, known, loops)
        self.node, self.head = node, ""
        sized = {id(n) for n in nodes if _asks_for_a_size(n) for n in ast.walk(n)}
        loaded = [n for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)]
        self.read = {n.id for n in loaded if id(n) not in sized}  # C does not ask an array for its length
        self.fresh: set[str] = set()  # variables that are declared where they are first assigned
        self.calls = 0  # calls that return several numbers
        assignments = [n for n in nodes if isinstance(n, ast.Assign | ast.AugAssign)]
        for _ in range(3):  # until the kinds of all assigned values are known
            for statement in assignments:
                if isinstance(statement, ast.Assign):
                    self.note_all(statement)
                else:
                    self.note(statement.target, self.kind(statement.value))

    def note_all(self, node: ast.Assign) -> None:
        """Record the kinds of the targets of an assignment."""
        several = self.kind(node.value)
        if isinstance(several, TupleKind) and isinstance(node.targets[0], ast.Tuple):
            for target, kind in zip(node.targets[0].elts, several.elements, strict=True):
                self.note(target, kind)
            return
        for target, value in self.pairs(node):
            self.note(target, self.kind(value))

    def note(self, target: ast.expr, kind: Kind) -> None:
        """Record the kind of a local variable; one real assignment makes it real."""
        if not isinstance(target, ast.Name) or target.id in self.known:
            return
        if target.id in self.loops:
            refuse(target, "also the variable of a loop")
        if self.local.get(target.id) != REAL:
            self.local[target.id] = kind

    def pairs(self, node: ast.Assign) -> Iterator[tuple[ast.expr, ast.expr]]:
        """Yield (target, value), one by one where a tuple is assigned to a tuple."""
        match node.targets[0], node.value:
            case ast.Tuple(targets), ast.Tuple(values) if len(targets) == len(values):
                yield from zip(targets, values, strict=True)
            case ast.Tuple(targets), value:
                struct = self.kind(value)
                if not isinstance(struct, StructKind):
                    refuse(node, "a tuple that is none")
                fields = [ast.Attribute(value, field, ast.Load()) for field in struct.fields]
                yield from zip(targets, fields, strict=True)
            case target, value:
                yield target, value

    def result(self) -> Kind:
        """Return the kind of the return value."""
        values = [node.value for node in ast.walk(self.node) if isinstance(node, ast.Return) and node.value]
        several = [value.elts for value in values if isinstance(value, ast.Tuple)]
        if several:
            columns = zip(*several, strict=True)
            return TupleKind(self.tuple_name(), tuple(self.either(*column) for column in columns))
        return "void" if not values else self.either(*values)

    def tuple_name(self) -> str:
        """Return the name of the struct of several numbers that are returned."""
        return f"{self.unit.entries.get(self.node.name, self.node.name)}_numbers"

    # --- text

    def lines(self) -> Iterator[str]:
        """Yield the lines of the function."""
        given = [declared(name, kind) for name, kind in self.known.items()]
        name = self.unit.entries.get(self.node.name, self.node.name)
        static, made = "" if self.node.name in self.unit.entries else "static ", self.unit.returned(self.node.name)
        self.head = f"{static}{declared(name, made)}({', '.join(given)})"
        body = self.node.body[1:] if ast.get_docstring(self.node) else self.node.body
        if doc := ast.get_docstring(self.node):
            yield comment(doc, 0)
        yield from wrapped(f"{self.head} {{", 0)
        yield from (f"    (void){name};" for name in self.known if name not in self.read)
        self.fresh = set(_first_assigned(body)) & set(self.local)
        later = ((name, kind) for name, kind in self.local.items() if name in self.read - self.fresh)
        yield from (f"    {declared(name, kind)};" for name, kind in later)
        yield from self.block(body, 1)
        yield "}"

    def block(self, block: Sequence[ast.stmt], depth: int) -> Iterator[str]:
        """Yield the lines of statements."""
        pad = "    " * depth
        for node in block:
            match node:
                case ast.Assign():
                    yield from self.assignment(node, depth)
                case ast.AugAssign(target, op, value):
                    yield from wrapped(
                        f"{self.text(target)} {SIGNS[type(op)][0]}= {self.stored(target, value)};", depth
                    )
                case ast.Return(ast.Tuple(values)):
                    made = self.unit.returned(self.node.name)
                    kinds = made.elements if isinstance(made, TupleKind) else ()
                    listed = ", ".join(map(self.of_kind, kinds, values))
                    yield from wrapped(f"return ({self.tuple_name()}){{{listed}}};", depth)
                case ast.Return(value):
                    kind = self.unit.returned(self.node.name)
                    yield from wrapped(f"return{f' {self.of_kind(kind, value)}' if value else ''};", depth)
                case ast.Expr(ast.Call() as call):
                    yield from wrapped(f"{self.text(call)};", depth)
                case ast.Break() | ast.Continue():
                    yield f"{pad}{'break' if isinstance(node, ast.Break) else 'continue'};"
                case ast.For(ast.Name(name), sequence, body, []):
                    yield from self.loop(name, sequence, depth)
                    yield from self.block(body, depth + 1)
                    yield f"{pad}}}"
                case ast.While(test, body, []):
                    yield f"{pad}while ({self.text(test)}) {{"
                    yield from self.block(body, depth + 1)
                    yield f"{pad}}}"
                case ast.If(test, body, orelse):
                    yield f"{pad}if ({self.text(test)}) {{"
                    yield from self.block(body, depth + 1)
                    if orelse:
                        yield f"{pad}}} else {{"
                        yield from self.block(orelse, depth + 1)
                    yield f"{pad}}}"
                case _:
                    refuse(node)

    def assignment(self, node: ast.Assign, depth: int) -> Iterator[str]:
        """Yield the lines of an assignment."""
        several = self.kind(node.value)
        if isinstance(several, TupleKind) and isinstance(node.targets[0], ast.Tuple):
            made = f"found{self.calls}"
            self.calls += 1
            yield from wrapped(f"const {several.name} {made} = {self.text(node.value)};", depth)
            for i, target in enumerate(node.targets[0].elts):
                if not isinstance(target, ast.Name) or target.id in self.read:
                    yield f"{'    ' * depth}{self.target(target)} = {made}._{i};"
            return
        pairs = list(self.pairs(node))
        _check_order(node, pairs)
        for target, value in pairs:
            if isinstance(target, ast.Name) and target.id not in self.read:
                continue
            if self.new_array(value):
                yield from self.memory(target, value, depth)
            elif isinstance(target, ast.Subscript) and any(isinstance(n, ast.Slice) for n in ast.walk(target.slice)):
                places = target.slice.elts if isinstance(target.slice, ast.Tuple) else [target.slice]
                yield from self.filled(target.value, places, value, depth)
            else:
                stored = self.stored(target, value)
                yield from wrapped(f"{self.target(target)} = {stored};", depth)

    def stored(self, target: ast.expr, value: ast.expr) -> str:
        """Return an assigned value, converted to the type of its target."""
        if isinstance(target, ast.Subscript) and isinstance(value, ast.BinOp | ast.Call | ast.IfExp | ast.Name):
            array = self.kind(target.value)
            if isinstance(array, ArrayKind) and array.element == SIDE:
                return f"({SIDE}){self.text(value, UNARY)}"
        return self.of_kind(self.kind(target), value)

    def memory(self, target: ast.expr, value: ast.expr, depth: int) -> Iterator[str]:
        """Yield the lines of a new array, which must be small because it is on the stack."""
        kind = self.kind(value)
        if not isinstance(target, ast.Name) or target.id not in self.fresh or not isinstance(kind, ArrayKind):
            refuse(value, "memory in a loop")
        self.fresh.remove(target.id)
        zeros = " = {0}" if ast.unparse(value).startswith("np.zeros") else ""
        yield f"{'    ' * depth}{kind.memory(target.id)}{zeros};"
        if isinstance(value, ast.Call) and isinstance(value.func, ast.Attribute) and value.func.attr == "copy":
            yield from self.filled(target, [], value.func.value, depth)

    def filled(self, array: ast.expr, places: Sequence[ast.expr], value: ast.expr, depth: int) -> Iterator[str]:
        """Yield the lines that fill an array, or its slice at `places`, with a number or another array's elements."""
        sizes, indices, loops = self.sizes(array), "", 0
        for axis, size in enumerate(sizes):
            match places[axis] if axis < len(places) else ast.Slice():
                case ast.Slice(lower, upper, None):
                    at, first = f"at{loops}", self.text(lower) if lower else "0"
                    most = self.text(upper, SUM) if upper else size
                    yield f"{'    ' * (depth + loops)}for (int {at} = {first}; {at} < {most}; {at}++) {{"
                    indices, loops = f"{indices}[{at}]", loops + 1
                case place:
                    indices += f"[{self.text(place)}]"
        copied = isinstance(self.kind(value), ArrayKind)
        wanted = self.text(value, ATOM) + "".join(f"[at{i}]" for i in range(loops)) if copied else self.text(value)
        yield f"{'    ' * (depth + loops)}{self.text(array, ATOM)}{indices} = {wanted};"
        yield from (f"{'    ' * (depth + loop)}}}" for loop in reversed(range(loops)))

    def target(self, node: ast.expr) -> str:
        """Return the text of an assignment's target, with a declaration if the variable is new."""
        if isinstance(node, ast.Name) and node.id in self.fresh:
            self.fresh.remove(node.id)
            return declared(node.id, self.local[node.id])
        return self.text(node)

    def loop(self, name: str, sequence: ast.expr, depth: int) -> Iterator[str]:
        """Yield the head of a loop over a range or the elements of an array of integers."""
        pad = "    " * depth
        if not isinstance(sequence, ast.Call):
            [size] = self.sizes(sequence)
            yield f"{pad}for (int at_{name} = 0; at_{name} < {size}; at_{name}++) {{"
            yield f"{pad}    const int {name} = {self.text(sequence)}[at_{name}];"
            return
        bounds = sequence.args
        begin, end = (ast.Constant(0), bounds[0]) if len(bounds) == 1 else bounds[:2]
        down = len(bounds) == 3
        if ast.unparse(sequence.func) != "range" or (down and ast.unparse(bounds[2]) != "-1"):
            refuse(sequence, "a loop over something else than a range in steps of 1 or -1")
        sign, step = (">", "--") if down else ("<", "++")
        yield f"{pad}for (int {name} = {self.text(begin)}; {name} {sign} {self.text(end, SUM)}; {name}{step}) {{"


def with_called(functions: Sequence[Function]) -> list[Function]:
    """Return `functions` and all that they call, directly or not, looked up in their globals."""
    found: dict[str, Function] = {}
    left = [*functions]
    while left:
        function = left.pop(0)
        node, names = parsed(function), getattr(function, "py_func", function).__globals__
        if node.name in found:
            continue
        found[node.name] = function
        called = [n.func.id for n in ast.walk(node) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)]
        left += [names[name] for name in dict.fromkeys(called) if not isbuiltin(names.get(name, abs))]
    return [*found.values()]


def _asks_for_a_size(node: ast.AST) -> bool:
    """Return whether the expression is an array's size."""
    match node:
        case ast.Call(ast.Name("len"), [_]) | ast.Attribute(_, "shape" | "size"):
            return True
    return False


def parsed(function: Function) -> ast.FunctionDef:
    """Return the tree of a function, or of the function that a numba dispatcher compiles."""
    return _tree(getattr(function, "py_func", function))


@cache
def _tree(function: Function) -> ast.FunctionDef:
    [node] = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    if not isinstance(node, ast.FunctionDef):
        raise Unprintable(f"{function} is no function")
    return simplified(node)


def _first_assigned(body: Sequence[ast.stmt]) -> Iterator[str]:
    """Yield the variables that are first assigned in `body` itself, not in its loops and branches."""
    seen: set[str] = set()
    for statement in body:
        stored = [n.id for n in ast.walk(statement) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
        if isinstance(statement, ast.Assign):
            yield from (name for name in stored if name not in seen)
        seen |= set(stored)


def _check_order(node: ast.Assign, pairs: Sequence[tuple[ast.expr, ast.expr]]) -> None:
    """Refuse a value that reads a name assigned just before: C assigns one after the other."""
    for i, (target, _) in enumerate(pairs):
        if any(ast.unparse(target) in map(ast.unparse, ast.walk(value)) for _, value in pairs[i + 1 :]):
            refuse(node, "a value asks for a name that has just been assigned")
