"""Statements of one function, printed as C line by line."""

import ast
from collections.abc import Iterator, Sequence

from allocator.compilation.printer.c_expressions import (
    ArrayKind,
    Constants,
    Expressions,
    Kind,
    StructKind,
    TupleKind,
    Unit,
    declared,
)
from allocator.compilation.printer.c_layout import ATOM, KEYWORDS, REAL, SIDE, SIGNS, SUM, UNARY, comment, wrapped
from allocator.compilation.printer.python_text import refuse, statements


class Statements(Expressions):
    """One function, line by line."""

    def __init__(self, unit: Unit, node: ast.FunctionDef) -> None:
        given = {argument.arg: unit.kind_of(argument) for argument in node.args.args}
        constants: dict[str, Kind] = {
            name: kind for one in given.values() if isinstance(one, Constants) for name, kind in one.elements
        }
        super().__init__(unit, given | constants)
        self.arguments = {name: kind for name, kind in given.items() if not isinstance(kind, Constants)}
        nodes = [*ast.walk(node)]
        self.counters = {n.target.id for n in nodes if isinstance(n, ast.For) and isinstance(n.target, ast.Name)}
        self.node, self.head, self.line = node, "", node.lineno
        _check_names(nodes, renamed=node.name in unit.entries)
        self.comments = unit.comments[node.name]
        sized = {id(n) for n in nodes if _asks_for_a_size(n) for n in ast.walk(n)}
        loaded = [n for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)]
        self.read = {n.id for n in loaded if id(n) not in sized}  # C does not ask an array for its length
        self.fresh: set[str] = set()  # variables that are declared where they are first assigned
        self.calls = 0  # calls that return several numbers
        assigned = [n for n in nodes if isinstance(n, ast.Assign | ast.AugAssign)]
        for _ in range(3):  # until the kinds of all assigned values are known
            for statement in assigned:
                if isinstance(statement, ast.Assign):
                    self.note_all(statement)
                else:
                    self.note(statement.target, self.kind(statement.value))

    def note_all(self, node: ast.Assign) -> None:
        """Record the kinds of the targets of an assignment."""
        for target, value in self.pairs(node.targets[0], node.value):
            if isinstance(target, ast.Tuple):
                several = self.kind(value)
                for one, kind in zip(target.elts, several.elements, strict=True):  # type: ignore[union-attr]  # a `TupleKind`
                    self.note(one, kind)
            elif isinstance(target, ast.Name) and isinstance(value, ast.Tuple):
                self.made.add(target.id)
                self.local[target.id] = self.struct_of(target)
            else:
                self.note(target, self.kind(value))

    def note(self, target: ast.expr, kind: Kind) -> None:
        """Record the kind of a local variable; one real assignment makes it real."""
        if not isinstance(target, ast.Name) or target.id in self.known:
            return
        if target.id in self.counters:
            refuse(target, "also the variable of a loop")
        if isinstance(kind, TupleKind):
            refuse(target, "a tuple that is not unpacked")
        if self.local.get(target.id) != REAL:
            self.local[target.id] = kind

    def struct_of(self, variable: ast.Name) -> StructKind:
        """Return the struct that a tuple becomes, by the argument that it is passed for."""
        for call in ast.walk(self.node):
            if isinstance(call, ast.Call) and (callee := self.unit.nodes.get(ast.unparse(call.func))):
                for argument, given in zip(callee.args.args, call.args, strict=False):
                    kind = self.unit.kind_of(argument)
                    if isinstance(given, ast.Name) and given.id == variable.id and isinstance(kind, StructKind):
                        return kind
        refuse(variable, "a tuple that nobody unpacks")

    def pairs(self, target: ast.expr, value: ast.expr) -> Iterator[tuple[ast.expr, ast.expr]]:
        """Yield (target, value), one by one where a tuple is assigned to a tuple; of a call that returns a tuple, all
        targets at once.
        """
        if not isinstance(target, ast.Tuple):
            yield target, value
            return
        kind = None if isinstance(value, ast.Tuple) else self.kind(value)
        match kind:
            case None:
                values = value.elts  # type: ignore[attr-defined]  # a tuple
            case TupleKind():
                yield target, value
                return
            case StructKind():
                values = [ast.Attribute(value, field, ast.Load()) for field in kind.fields]
            case ArrayKind():
                values = [ast.Subscript(value, ast.Constant(i), ast.Load()) for i, _ in enumerate(target.elts)]
            case Constants():
                values = [ast.Name(name, ast.Load()) for name, _ in kind.elements]
            case _:
                refuse(value, "a tuple that is none")
        if len(values) != len(target.elts):
            refuse(value, f"{len(values)} in the place of {len(target.elts)}")
        for one, its in zip(target.elts, values, strict=True):
            yield from self.pairs(one, its)

    def result(self) -> Kind:
        """Return the kind of the return value."""
        values = [node.value for node in ast.walk(self.node) if isinstance(node, ast.Return) and node.value]
        several = [value.elts for value in values if isinstance(value, ast.Tuple)]
        if several:
            kinds = tuple(self.either(*column) for column in zip(*several, strict=True))
            named = self.unit.outside.structs.get(tuple(map(ast.unparse, several[0])))
            own = f"{self.unit.entries.get(self.node.name, self.node.name)}_numbers"
            fields = map(ast.unparse, several[0]) if named else (f"_{i}" for i, _ in enumerate(kinds))
            return TupleKind(named or own, kinds, tuple(fields))
        return "void" if not values else self.either(*values)

    # --- text

    def lines(self) -> Iterator[str]:
        """Yield the lines of the function."""
        given = [declared(name, kind) for name, kind in self.arguments.items()]
        name, made = self.unit.entries.get(self.node.name, self.node.name), self.unit.returned(self.node.name)
        inner = "" if self.node.name in self.unit.entries else f"{self.unit.outside.inner} "
        self.head = f"{inner}{declared(name, made)}({', '.join(given)})"
        body = statements(self.node)
        if doc := ast.get_docstring(self.node):
            yield comment(doc, 0)
        yield from wrapped(f"{self.head} {{", 0)
        yield from (f"    (void){name};" for name in self.arguments if name not in self.read)
        self.fresh = set(_first_assigned(body)) & set(self.local)
        later = ((name, kind) for name, kind in self.local.items() if name in self.read - self.fresh)
        yield from (f"    {declared(name, kind)};" for name, kind in later)
        yield from self.block(body, 1)
        yield "}"

    def block(self, block: Sequence[ast.stmt], depth: int) -> Iterator[str]:
        """Yield the lines of statements."""
        pad = "    " * depth
        for node in block:
            yield from self.said(node, depth)
            match node:
                case ast.Assign():
                    yield from self.assignment(node, depth)
                case ast.AugAssign(target, op, value):
                    yield from wrapped(
                        f"{self.text(target)} {SIGNS[type(op)][0]}= {self.stored(target, value)};", depth
                    )
                case ast.Return(ast.Tuple(values)):
                    made: TupleKind = self.unit.returned(self.node.name)  # type: ignore[assignment]  # see `result`
                    listed = ", ".join(map(self.of_kind, made.elements, values))
                    yield from wrapped(f"return ({made.name}){{{listed}}};", depth)
                case ast.Return(value):
                    kind = self.unit.returned(self.node.name)
                    yield from wrapped(f"return{f' {self.of_kind(kind, value)}' if value else ''};", depth)
                case ast.Expr(ast.Call() as call):
                    yield from wrapped(f"{self.text(call)};", depth)
                case ast.Break() | ast.Continue():
                    yield f"{pad}{'break' if isinstance(node, ast.Break) else 'continue'};"
                case ast.For(ast.Name(name), sequence, body, []):
                    yield from self.loop(name, sequence, depth)
                    around, self.loops = self.loops, self.loops | {name}
                    yield from self.block(body, depth + 1)
                    self.loops = around
                    yield f"{pad}}}"
                case ast.While(test, body, []):
                    yield f"{pad}while ({self.truth(test)}) {{"
                    yield from self.block(body, depth + 1)
                    yield f"{pad}}}"
                case ast.If(test, body, orelse):
                    yield f"{pad}if ({self.truth(test)}) {{"
                    yield from self.block(body, depth + 1)
                    if orelse:
                        yield f"{pad}}} else {{"
                        yield from self.block(orelse, depth + 1)
                    yield f"{pad}}}"
                case _:
                    refuse(node)

    def said(self, node: ast.stmt, depth: int) -> Iterator[str]:
        """Yield the comments above a statement and beside it."""
        last = node.lineno if isinstance(node, ast.If | ast.For | ast.While) else node.end_lineno or node.lineno
        yield from (comment(self.comments[n], depth) for n in range(self.line + 1, last + 1) if n in self.comments)
        self.line = max(self.line, last)

    def assignment(self, node: ast.Assign, depth: int) -> Iterator[str]:
        """Yield the lines of an assignment."""
        pairs = list(self.pairs(node.targets[0], node.value))
        _check_order(node, pairs)
        for target, value in pairs:
            if isinstance(target, ast.Tuple):
                yield from self.several(target, value, depth)
            elif isinstance(target, ast.Name) and target.id not in self.read:
                continue
            elif isinstance(target, ast.Name) and target.id in self.made:
                yield from self.struct(target, value, depth)
            elif self.new_array(value):
                yield from self.memory(target, value, depth)
            elif isinstance(target, ast.Subscript) and any(isinstance(n, ast.Slice) for n in ast.walk(target.slice)):
                places = target.slice.elts if isinstance(target.slice, ast.Tuple) else [target.slice]
                yield from self.filled(target.value, places, value, depth)
            else:
                stored = self.stored(target, value)
                yield from wrapped(f"{self.target(target)} = {stored};", depth)

    def several(self, targets: ast.Tuple, value: ast.expr, depth: int) -> Iterator[str]:
        """Yield the lines that assign the returned tuple of numbers `value`."""
        kind: TupleKind = self.kind(value)  # type: ignore[assignment]  # see `pairs`
        found = f"found{self.calls}"
        self.calls += 1
        yield from wrapped(f"const {kind.name} {found} = {self.text(value)};", depth)
        for field, target in zip(kind.fields, targets.elts, strict=True):
            if not isinstance(target, ast.Name) or target.id in self.read:
                yield f"{'    ' * depth}{self.target(target)} = {found}.{field};"

    def struct(self, target: ast.Name, value: ast.expr, depth: int) -> Iterator[str]:
        """Yield the lines of a struct made of a tuple."""
        kind = self.local[target.id]
        if target.id not in self.fresh or not isinstance(value, ast.Tuple) or not isinstance(kind, StructKind):
            refuse(value, "a tuple assigned again")
        self.fresh.remove(target.id)
        yield from wrapped(f"const {kind.name} {target.id} = {self.braced(kind, value)};", depth)

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


def _check_names(nodes: Sequence[ast.AST], renamed: bool) -> None:
    """Refuse a function, unless it is `renamed`, an argument or a variable named like a keyword of C."""
    for node in nodes:
        match node:
            case ast.FunctionDef(name=name) if not renamed:
                pass
            case ast.arg(name) | ast.Name(name, ast.Store()):
                pass
            case _:
                continue
        if name in KEYWORDS:
            refuse(ast.copy_location(ast.Name(name), node), "a keyword of C")


def _asks_for_a_size(node: ast.AST) -> bool:
    """Return whether the expression is an array's size."""
    match node:
        case ast.Call(ast.Name("len"), [_]) | ast.Attribute(_, "shape" | "size"):
            return True
    return False


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
    new: set[str] = set()
    for target, value in pairs:
        if new & {*map(ast.unparse, ast.walk(value))}:
            refuse(node, "a value asks for a name that has just been assigned")
        new |= {*map(ast.unparse, target.elts if isinstance(target, ast.Tuple) else [target])} - {"_"}
