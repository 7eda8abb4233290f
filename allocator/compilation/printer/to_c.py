"""Printing of plain Python functions as readable C99, with their docstrings and comments.

A tuple becomes a struct. A passed tuple is named after the parameter that receives it, and its fields after the names
that it is unpacked into. A returned tuple is named after the function, and its fields after the names returned.
`Outside` lists the tuples supplied by callers and C's other differences.
"""

import ast
from collections.abc import Iterator, Sequence

from allocator.compilation.printer.c_declarations import Outside, Text, Unit, arguments_of
from allocator.compilation.printer.c_expressions import Expressions
from allocator.compilation.printer.c_layout import INT, REAL, SUM, Printed, comment, runs, whole, wrapped
from allocator.compilation.printer.python_text import Source, asks_for_none, assignments, refuse, statements


def c_form(source: Source, entry: str, outside: Outside = Outside()) -> Printed:  # noqa: B008  # frozen
    """Return the C text of `entry` and of its callees. Raises Unprintable for constructs without a C form."""
    order = source.reached(entry)
    unit = Unit(source, outside, entry, _print, [name for name in order if name not in outside.names])
    unit.function(entry, [unit.given(name) for name in arguments_of(source.functions[entry])])
    returned = unit.returns[entry]
    own = [text for name, text in unit.structs.items() if name != returned]
    head = [unit.structs[returned]] if returned in unit.structs else []
    head += [unit.heads[entry]]
    done = [unit.bodies[name] for name in order if name in unit.bodies]
    return Printed("\n\n".join(head), "\n\n".join([*own, *unit.constants.values(), *done]))


def _print(unit: Unit, function: ast.FunctionDef, kinds: list[str]) -> None:
    _Function(unit, function, kinds).print()


class _Function:
    """Printer of one function into its unit, line by line."""

    def __init__(self, unit: Unit, function: ast.FunctionDef, kinds: list[str]) -> None:
        names = arguments_of(function)
        self.unit, self.function = unit, function
        self.kinds = {name: kind for name, kind in zip(names, kinds, strict=True) if kind}
        self.say = Expressions(unit, self.kinds)
        nodes = [node for node in ast.walk(function) if isinstance(node, ast.Name)]
        self.read = {node.id for node in nodes if isinstance(node.ctx, ast.Load)}
        self.stored = [node.id for node in nodes if isinstance(node.ctx, ast.Store)]
        self.returned = ""
        self.line = function.lineno  # last line whose comments have been printed
        self.results = 0

    def print(self) -> None:
        """Add the function to its unit, after its callees."""
        name = self.function.name
        given = [f"const {kind} *{x}" if x in self.say.pointers else f"{kind} {x}" for x, kind in self.kinds.items()]
        unused = [f"    (void){x};" for x in self.kinds if x not in self.read]  # silences a warning
        body = unused + list(self.block(statements(self.function), 1))
        self.unit.returns[name] = self.returned
        listed = ", ".join(whole(one.replace("* ", "*")) for one in given)
        head = f"{self.returned} {self.unit.called(name)}({listed})"
        head = head if name == self.unit.entry else f"{self.unit.outside.inner} {head}"
        self.unit.heads[name] = "\n".join(wrapped(head + ";", 0))
        doc = [comment(text, 0) for text in (ast.get_docstring(self.function),) if text]
        self.unit.bodies[name] = "\n".join([*doc, *wrapped(head + " {", 0), *body, "}"])

    # --- statements

    def block(self, block: Sequence[ast.stmt], depth: int) -> Iterator[str]:
        """Yield the lines of `block`."""
        for statement in block:
            yield from self.said(statement, depth)
            match statement:
                case ast.Assign():
                    yield from self.assign(statement, depth)
                case ast.Return(ast.expr() as value):
                    yield from wrapped(f"return {self.result(value)};", depth)
                case ast.If(test, body, orelse):
                    yield from self.branch(test, body, orelse, depth)
                case ast.For(ast.Name(name), ast.Call(ast.Name("range"), [count]), body, []):
                    yield from self.loop(statement, name, self.say.text(count).above(SUM), body, depth)
                case _:
                    refuse(statement)

    def loop(self, node: ast.stmt, name: str, count: str, body: list[ast.stmt], depth: int) -> Iterator[str]:
        """Yield the lines of a loop, whose variable is local to it."""
        name = f"i{depth}" if name == "_" else name
        if name in self.kinds or self.stored.count(name) > 1:
            refuse(node, f"{name} is also assigned elsewhere")
        self.kinds[name] = INT
        yield from wrapped(f"for (int {name} = 0; {name} < {count}; {name}++) {{", depth)
        yield from self.block(body, depth + 1)
        yield "    " * depth + "}"
        del self.kinds[name]

    def branch(self, test: ast.expr, body: list[ast.stmt], orelse: list[ast.stmt], depth: int) -> Iterator[str]:
        """Yield the lines of an `if`; only one side if the test is known."""
        if asks_for_none(test) in self.unit.outside.none:
            yield from self.block(body, depth)
            return
        yield from wrapped(f"if ({self.say.text(test).text}) {{", depth)
        yield from self.block(body, depth + 1)
        if orelse:
            yield "    " * depth + "} else {"
            yield from self.block(orelse, depth + 1)
        yield "    " * depth + "}"

    def said(self, statement: ast.stmt, depth: int) -> Iterator[str]:
        """Yield the comments above `statement` and beside it."""
        last = statement.lineno if isinstance(statement, ast.If | ast.For) else statement.end_lineno or statement.lineno
        for line in range(self.line + 1, last + 1):
            if line in self.unit.comments:
                yield comment(self.unit.comments[line], depth)
        self.line = last

    def assign(self, statement: ast.Assign, depth: int) -> Iterator[str]:
        """Yield declarations and assignments."""
        fresh: list[tuple[str, str]] = []  # type, declarator
        for target, value in assignments(statement):
            for name, made in self.parts(target, value, fresh):
                if name in self.kinds:
                    if (made.kind, self.kinds[name]) not in ((REAL, REAL), (INT, INT), (INT, REAL)):
                        refuse(statement, f"{name} is {self.kinds[name]}, not {made.kind}")
                    yield from self.declared(fresh, depth)
                    yield from wrapped(f"{name} = {made.text};", depth)
                    continue
                if depth > 1:
                    refuse(statement, "first assigned in a branch or loop")
                self.kinds[name] = made.kind
                const = "const " if self.stored.count(name) == 1 else ""
                fresh.append((const + made.kind, f"{name} = {made.text}"))
        yield from self.declared(fresh, depth)

    @staticmethod
    def declared(fresh: list[tuple[str, str]], depth: int) -> Iterator[str]:
        """Yield the declarations collected so far."""
        for kind, declarators in runs(fresh):
            yield from wrapped(f"{kind} {', '.join(map(whole, declarators))};", depth)
        fresh.clear()

    def parts(self, target: ast.expr, value: ast.expr, fresh: list[tuple[str, str]]) -> Iterator[tuple[str, Text]]:
        """Yield (name, assigned value)."""
        match target, value:
            case ast.Name(name), ast.Tuple():
                yield name, self.say.tuple(value, self.taken_as(name) or name)
            case ast.Name(name), _:
                yield name, self.say.text(value)
            case ast.Tuple(names), _:
                elements = self.elements(value, fresh)
                if len(elements) != len(names):
                    refuse(value, f"{len(elements)} in the place of {len(names)}")
                for one, element in zip(names, elements, strict=True):
                    if not isinstance(one, ast.Name):
                        refuse(target)
                    if one.id in self.read:  # C compilers warn about unused variables
                        yield one.id, element

    def elements(self, value: ast.expr, fresh: list[tuple[str, str]]) -> list[Text]:
        """Return the elements of the tuple `value`."""
        outside = self.unit.outside
        if isinstance(value, ast.Name) and value.id in outside.numbers:
            return [Text(text, kind) for kind, text in outside.numbers[value.id].values()]
        if isinstance(value, ast.Name) and value.id in outside.arrays:
            return [Text(f"{value.id}[{i}]", REAL) for i, _ in enumerate(self.unit.fields[value.id])]
        made = self.say.text(value)
        if made.kind not in self.unit.kinds:
            refuse(value, "no tuple")
        name = made.text
        if not isinstance(value, ast.Name):
            self.results += 1
            name = f"found{self.results}"
            fresh.append((f"const {made.kind}", f"{name} = {made.text}"))
        dot = "->" if name in self.say.pointers else "."
        kinds, fields = self.unit.kinds[made.kind], self.unit.names[made.kind]
        return [Text(f"{name}{dot}{field}", kind) for field, kind in zip(fields, kinds, strict=True)]

    def taken_as(self, name: str) -> str:
        """Return the parameter that `name` is passed to; "" if it is passed to no function."""
        for call in ast.walk(self.function):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id in self.unit.printed:
                arguments = arguments_of(self.unit.source.functions[call.func.id])
                for argument, given in zip(arguments, call.args, strict=False):
                    if isinstance(given, ast.Name) and given.id == name:
                        return argument
        return ""

    def result(self, value: ast.expr) -> str:
        """Return the returned expression, and record its type."""
        if isinstance(value, ast.Tuple):
            names = [e.id for e in value.elts if isinstance(e, ast.Name)]
            if len(names) != len(value.elts):
                refuse(value, "only names can be returned in a tuple")
            kinds = [self.say.text(e).kind for e in value.elts]
            about = f"Return value of {self.function.name}."
            kind = self.unit.struct(value, f"ant_{self.function.name}", names, kinds, about)
            made = Text(f"({kind}){{{', '.join(names)}}}", kind)
        else:
            made = self.say.text(value)
        if self.returned and self.returned != made.kind:
            refuse(value, f"{made.kind} is returned, and {self.returned} elsewhere")
        self.returned = made.kind
        return made.text
