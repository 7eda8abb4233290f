"""Printing of plain Python functions as readable C99, with their docstrings and comments.

A tuple becomes a struct. A passed tuple is named after the parameter that receives it, and its fields after the names
that it is unpacked into. A returned tuple is named after the function, and its fields after the names returned.
`Outside` lists the tuples supplied by callers and C's other differences.
"""

import ast
from collections.abc import Iterator, Sequence

from allocator.compilation.printer.c_layout import (
    AND,
    ATOM,
    CHOICE,
    FLAGS,
    INT,
    LINK,
    LINKS,
    MADE,
    OR,
    REAL,
    SIGNS,
    SUM,
    UNARY,
    Outside,
    Printed,
    Text,
    Unit,
    arguments_of,
    comment,
    compared,
    literal,
    runs,
    whole,
    wrapped,
)
from allocator.compilation.printer.python_text import Source, asks_for_none, assignments, refuse, statements


class Expressions:
    """Printer of one function's expressions, given the kinds of its variables."""

    def __init__(self, unit: Unit, kinds: dict[str, str]) -> None:
        self.unit, self.kinds = unit, kinds
        self.pointers = {name for name, kind in kinds.items() if kind in unit.kinds}  # arguments that are structs

    def text(self, node: ast.expr) -> Text:
        """Return C's text of the expression `node`."""
        match node:
            case ast.Name(name):
                return Text(name, self.kinds[name]) if name in self.kinds else self.unit.constant(node)
            case ast.Constant(bool() | int() | float() as value):
                return literal(value)
            case ast.UnaryOp(ast.USub(), operand):
                inner = self.text(operand)
                return Text(f"-{inner.above(UNARY + inner.text.startswith('-') * ATOM)}", inner.kind, UNARY)
            case ast.UnaryOp(ast.Not(), operand):
                return Text(f"!{self.truth(operand).above(UNARY)}", INT, UNARY)
            case ast.BinOp(left, op, right):
                return self.binary(node, self.text(left), op, self.text(right))
            case ast.BoolOp(op, values):
                sign, level = (" && ", AND) if isinstance(op, ast.And) else (" || ", OR)
                return Text(sign.join(self.truth(value).above(LINK) for value in values), INT, level)
            case ast.Compare():
                return self.comparison(node)
            case ast.IfExp(test, body, orelse):
                return self.choice(test, body, orelse)
            case ast.Call(ast.Name(name), arguments):
                return self.call(node, name, arguments)
        refuse(node)

    def truth(self, node: ast.expr) -> Text:
        """Return a truth value."""
        made = self.text(node)
        if made.kind != INT:
            refuse(node, "no truth value")
        return made

    def binary(self, node: ast.BinOp, left: Text, op: ast.operator, right: Text) -> Text:
        """Return a sum, a product or a combination of flags."""
        kind = INT if left.kind == right.kind == INT else REAL
        if {left.kind, right.kind} - {INT, REAL}:
            refuse(node, "a tuple")
        if isinstance(op, ast.BitOr):
            if kind != INT:
                refuse(node, "no flags")
            first = left.text if " | " in left.text and left.level == FLAGS else left.above(UNARY)
            return Text(f"{first} | {right.above(UNARY)}", INT, FLAGS)
        sign, level = SIGNS[type(op)]
        if isinstance(op, ast.Div) and kind == INT:
            left, kind = Text(f"({REAL}){left.above(UNARY)}", REAL, UNARY), REAL
        return Text(f"{left.above(level)} {sign} {right.above(level + 1)}", kind, level)

    def comparison(self, node: ast.Compare) -> Text:
        """Return a chain of comparisons, or the test that an argument is None."""
        if name := asks_for_none(node):
            if name not in self.unit.outside.absent:
                refuse(node, "C has no None")
            return Text(self.unit.outside.absent[name], INT, LINK)
        if not all(type(op) in LINKS for op in node.ops):
            refuse(node)
        operands = [self.text(operand) for operand in (node.left, *node.comparators)]
        links = [
            compared(a.above(SUM), op, b.above(SUM), REAL if REAL in (a.kind, b.kind) else INT)
            for a, op, b in zip(operands, node.ops, operands[1:], strict=False)
        ]
        return Text(" && ".join(text for text, _ in links), INT, AND if len(links) > 1 else links[0][1])

    def choice(self, test: ast.expr, body: ast.expr, orelse: ast.expr) -> Text:
        """Return a conditional expression; only one side if the test is known."""
        if asks_for_none(test) in self.unit.outside.none:
            return self.text(body)
        yes, no = self.text(body), self.text(orelse)
        if yes.kind != no.kind and {yes.kind, no.kind} != {INT, REAL}:
            refuse(body, f"{yes.kind} or {no.kind}")
        kind = yes.kind if yes.kind == no.kind else REAL
        return Text(f"{self.text(test).above(OR)} ? {yes.above(OR)} : {no.above(CHOICE)}", kind, CHOICE)

    def call(self, node: ast.Call, name: str, arguments: list[ast.expr]) -> Text:
        """Return a call of a printed function or of an existing one."""
        if name not in self.unit.printed:
            known = {**MADE, **self.unit.outside.names}
            if name not in known:
                refuse(node, "C has no such function")
            return Text(f"{known[name]}({', '.join(self.text(a).text for a in arguments)})", REAL)
        names = arguments_of(self.unit.source.functions[name])
        if len(names) != len(arguments):
            refuse(node, "arguments are missing")
        made = [self.argument(given, taken) for given, taken in zip(arguments, names, strict=True)]
        kind = self.unit.function(name, [one.kind for one in made])
        return Text(f"{self.unit.called(name)}({', '.join(map(self.passed, made))})", kind)

    def argument(self, given: ast.expr, taken: str) -> Text:
        """Return the argument `given` for the parameter `taken`."""
        if isinstance(given, ast.Tuple):
            return self.tuple(given, taken)
        if isinstance(given, ast.Name) and isinstance(self.unit.source.names.get(given.id), tuple):
            return self.unit.constant_struct(given, taken) if given.id not in self.kinds else self.text(given)
        return self.text(given)

    def passed(self, argument: Text) -> str:
        """Return how `argument` is passed: structs by their address."""
        if argument.kind not in self.unit.kinds or argument.text in self.pointers:
            return argument.text
        cast = f"({argument.kind})" if argument.text.startswith("{") else ""
        return f"&{cast}{argument.text}"

    def tuple(self, value: ast.Tuple, name: str) -> Text:
        """Return the struct that holds `value`, called as the argument `name`."""
        made = [self.text(element) for element in value.elts]
        return Text(f"{{{', '.join(one.text for one in made)}}}", self.unit.struct_of(value, name, made))


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
