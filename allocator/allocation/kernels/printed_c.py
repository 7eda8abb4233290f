"""The printer for C: functions of plain Python as C99 that reads like them, docstrings and comments included.

A variable is of `real` type, an int (flags and truth values) or a struct; what is assigned to it decides. A tuple is a
struct: one that is passed on is called as the argument that takes it and unpacks it into names, which are its fields;
one that is returned is called as the function and has the names returned. The tuples that come from outside are named
in `Outside`, with what else C has that Python has not.
"""

import ast
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple

from allocator.allocation.kernels.printed import Source, asks_for_none, assignments, refuse, statements

REAL, INT = "ant_real", "int"
_WIDTH = 120
_ASCII = str.maketrans(
    {"θ": "theta", "ε": "eps", "τ": "tau", "κ": "kappa", "β": "beta", "·": "*", "²": "^2", "³": "^3", "±": "+-"}
    | {"≤": "<=", "≥": ">=", "`": ""}
)
_LINKS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_SIGNS = {ast.Add: ("+", 12), ast.Sub: ("-", 12), ast.Mult: ("*", 13), ast.Div: ("/", 13)}
_MADE = {"inf": "ANT_INFINITY", "sqrt": "ANT_F(sqrt)", "abs": "ant_abs"}  # names that C has anyway
_CHOICE, _OR, _AND, _FLAGS, _LINK, _SUM, _UNARY, _ATOM = 3, 4, 5, 6, 10, 12, 14, 16  # how strongly C's operators bind


class Outside(NamedTuple):
    """What the printed text finds in C: names, arguments that are known or never given, arrays in the place of tuples."""

    names: Mapping[str, str] = {}  # of functions that C has and of constants, by Python's name
    functions: Mapping[str, str] = {}  # what printed functions are called; those named here are not static
    structs: Mapping[tuple[str, ...], str] = {}  # what structs with these fields are called
    numbers: Mapping[str, Mapping[str, tuple[str, str]]] = {}  # a tuple's name: each element's type, and its text
    arrays: frozenset[str] = frozenset()  # tuples of `entry` that C has as arrays of real numbers
    flags: frozenset[str] = frozenset()  # arguments of `entry` that are ints
    absent: Mapping[str, str] = {}  # when an argument counts as None
    none: frozenset[str] = frozenset()  # arguments of `entry` that always are
    inner: str = "static"  # how functions other than `entry` begin


class Printed(NamedTuple):
    """C's text of a function: what a header has to say, and what comes into a file."""

    head: str  # the struct that it returns, and its prototype
    body: str


class _Text(NamedTuple):
    """An expression."""

    text: str
    kind: str
    level: int = _ATOM

    def above(self, level: int) -> str:
        """Return it in parentheses unless its operator binds at least as strongly as `level`."""
        return self.text if self.level >= level else f"({self.text})"


def c_form(source: Source, entry: str, outside: Outside = Outside()) -> Printed:  # noqa: B008  # frozen
    """Return C's text of `entry` and of what it calls. Raises Unprintable for what C's form has not."""
    order = source.reached(entry)
    unit = _Unit(source, outside, entry, [name for name in order if name not in outside.names])
    unit.function(entry, [unit.given(name) for name in _arguments(source.functions[entry])])
    returned = unit.returns[entry]
    own = [text for name, text in unit.structs.items() if name != returned]
    head = [unit.structs[returned]] if returned in unit.structs else []
    head += [unit.heads[entry]]
    done = [unit.bodies[name] for name in order if name in unit.bodies]
    return Printed("\n\n".join(head), "\n\n".join([*own, *unit.constants.values(), *done]))


def _arguments(function: ast.FunctionDef) -> list[str]:
    return [argument.arg for argument in function.args.args]


class _Unit:
    """The text under way: its structs, constants and functions by name."""

    def __init__(self, source: Source, outside: Outside, entry: str, printed: Sequence[str]) -> None:
        self.source, self.outside, self.entry, self.printed = source, outside, entry, frozenset(printed)
        self.comments = source.comments()
        self.fields = dict(self._unpacked(printed))  # of the struct that an argument of this name is
        self.names: dict[str, list[str]] = {}  # of a struct's fields
        self.kinds: dict[str, list[str]] = {}  # of a struct's fields
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
        """Return the kind of the argument `name` of the entry; "" for one that C has no need of."""
        if name in self.outside.none or name in self.outside.numbers:
            return ""
        if name in self.outside.arrays:
            return f"const {REAL} *"
        return INT if name in self.outside.flags else REAL

    def struct(self, name: str, fields: Sequence[str], kinds: Sequence[str], about: str) -> str:
        """Return the name of the struct with these fields, which is made where there is none."""
        name = self.outside.structs.get(tuple(fields), name)
        if self.kinds.setdefault(name, list(kinds)) != list(kinds):
            raise TypeError(f"{name} has fields of other kinds elsewhere")
        self.names.setdefault(name, list(fields))
        lines = [f"    {kind} {', '.join(names)};" for kind, names in _runs(zip(kinds, fields, strict=True))]
        self.structs.setdefault(name, "\n".join([f"/* {about} */", "typedef struct {", *lines, f"}} {name};"]))
        return name

    def function(self, name: str, kinds: list[str]) -> str:
        """Print the function `name` for arguments of these kinds, unless it is there; return what it returns."""
        if self.taken.setdefault(name, kinds) != kinds:
            refuse(self.source.functions[name], f"called with {kinds} and with {self.taken[name]}")
        if name not in self.returns:
            _Function(self, self.source.functions[name], kinds).print()
        return self.returns[name]

    def constant(self, node: ast.Name) -> _Text:
        """Return what the global number `node` stands for, or C's name for it."""
        value, known = self.source.names.get(node.id), {**_MADE, **self.outside.names}
        if not isinstance(value, int | float):
            refuse(node, "no number")
        return _literal(value)._replace(text=known[node.id]) if node.id in known else _literal(value)

    def constant_struct(self, node: ast.Name, name: str) -> _Text:
        """Return the global tuple of numbers `node` as a constant struct, called as the argument `name`."""
        values = [_literal(value) for value in self.source.names[node.id]]
        text = self.outside.names.get(node.id, f"{{{', '.join(value.text for value in values)}}}")
        kind = self.struct_of(node, name, values)
        self.constants[node.id] = f"static const {kind} {node.id} = {text};"
        return _Text(node.id, kind)

    def struct_of(self, node: ast.expr, name: str, values: Sequence[_Text]) -> str:
        """Return the struct that holds `values`, called as the argument `name`."""
        fields = self.fields.get(name, [])
        if len(fields) != len(values):
            refuse(node, f"{name} is not unpacked into as many names")
        return self.struct(f"ant_{name}", fields, [value.kind for value in values], f"What is called {name} below.")

    def called(self, name: str) -> str:
        """Return what C calls the function `name`."""
        return self.outside.functions.get(name, name)


class _Function:
    """One function under way."""

    def __init__(self, unit: _Unit, function: ast.FunctionDef, kinds: list[str]) -> None:
        names = _arguments(function)
        self.unit, self.function = unit, function
        self.kinds = {name: kind for name, kind in zip(names, kinds, strict=True) if kind}
        self.pointers = {name for name, kind in self.kinds.items() if kind in unit.kinds}
        nodes = [node for node in ast.walk(function) if isinstance(node, ast.Name)]
        self.read = {node.id for node in nodes if isinstance(node.ctx, ast.Load)}
        stored = [node.id for node in nodes if isinstance(node.ctx, ast.Store)]
        self.constant = {name for name in stored if stored.count(name) == 1}
        self.returned = ""
        self.line = function.lineno  # up to which comments have been printed
        self.results = 0

    def print(self) -> None:
        """Put the function into its unit, behind those that it calls."""
        name = self.function.name
        given = [f"const {kind} *{x}" if x in self.pointers else f"{kind} {x}" for x, kind in self.kinds.items()]
        body = list(self.block(statements(self.function), 1))
        self.unit.returns[name] = self.returned
        listed = ", ".join(_whole(one.replace("* ", "*")) for one in given)
        head = f"{self.returned} {self.unit.called(name)}({listed})"
        head = head if name == self.unit.entry else f"{self.unit.outside.inner} {head}"
        self.unit.heads[name] = "\n".join(_wrapped(head + ";", 0))
        doc = [_comment(text, 0) for text in (ast.get_docstring(self.function),) if text]
        self.unit.bodies[name] = "\n".join([*doc, *_wrapped(head + " {", 0), *body, "}"])

    # --- statements

    def block(self, block: Sequence[ast.stmt], depth: int) -> Iterator[str]:
        """Yield the lines of `block`."""
        for statement in block:
            yield from self.said(statement, depth)
            match statement:
                case ast.Assign():
                    yield from self.assign(statement, depth)
                case ast.Return(ast.expr() as value):
                    yield from _wrapped(f"return {self.result(value)};", depth)
                case ast.If(test, body, orelse):
                    yield from self.branch(test, body, orelse, depth)
                case ast.For(ast.Name(name), ast.Call(ast.Name("range"), [count]), body, []):
                    name = "i" if name == "_" else name
                    self.kinds[name] = INT
                    yield from _wrapped(
                        f"for (int {name} = 0; {name} < {self.text(count).above(_SUM)}; {name}++) {{", depth
                    )
                    yield from self.block(body, depth + 1)
                    yield "    " * depth + "}"
                case _:
                    refuse(statement)

    def branch(self, test: ast.expr, body: list[ast.stmt], orelse: list[ast.stmt], depth: int) -> Iterator[str]:
        """Yield the lines of an `if`; of one side only if it is known which."""
        if asks_for_none(test) in self.unit.outside.none:
            yield from self.block(body, depth)
            return
        yield from _wrapped(f"if ({self.text(test).text}) {{", depth)
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
                yield _comment(self.unit.comments[line], depth)
        self.line = last

    def assign(self, statement: ast.Assign, depth: int) -> Iterator[str]:
        """Yield declarations and assignments."""
        fresh: list[tuple[str, str]] = []  # type, declarator
        for target, value in assignments(statement):
            for name, made in self.parts(target, value, fresh):
                if name in self.kinds:
                    if made.kind != self.kinds[name] and (made.kind, self.kinds[name]) != (INT, REAL):
                        refuse(statement, f"{name} is {self.kinds[name]}, not {made.kind}")
                    yield from self.declared(fresh, depth)
                    yield from _wrapped(f"{name} = {made.text};", depth)
                    continue
                if depth > 1:
                    refuse(statement, "first assigned in a branch or loop")
                self.kinds[name] = made.kind
                const = "const " if name in self.constant else ""
                fresh.append((const + made.kind, f"{name} = {made.text}"))
        yield from self.declared(fresh, depth)

    @staticmethod
    def declared(fresh: list[tuple[str, str]], depth: int) -> Iterator[str]:
        """Yield the declarations collected so far."""
        for kind, declarators in _runs(fresh):
            yield from _wrapped(f"{kind} {', '.join(map(_whole, declarators))};", depth)
        fresh.clear()

    def parts(self, target: ast.expr, value: ast.expr, fresh: list[tuple[str, str]]) -> Iterator[tuple[str, _Text]]:
        """Yield (name, what is assigned to it)."""
        match target, value:
            case ast.Name(name), ast.Tuple():
                yield name, self.tuple(value, self.taken_as(name) or name)
            case ast.Name(name), _:
                yield name, self.text(value)
            case ast.Tuple(names), _:
                elements = self.elements(value, fresh)
                if len(elements) != len(names):
                    refuse(value, f"{len(elements)} in the place of {len(names)}")
                for one, element in zip(names, elements, strict=True):
                    if not isinstance(one, ast.Name):
                        refuse(target)
                    if one.id in self.read:  # C's compilers warn of others
                        yield one.id, element

    def elements(self, value: ast.expr, fresh: list[tuple[str, str]]) -> list[_Text]:
        """Return what the tuple `value` holds."""
        outside = self.unit.outside
        if isinstance(value, ast.Name) and value.id in outside.numbers:
            return [_Text(text, kind) for kind, text in outside.numbers[value.id].values()]
        if isinstance(value, ast.Name) and value.id in outside.arrays:
            return [_Text(f"{value.id}[{i}]", REAL) for i, _ in enumerate(self.unit.fields[value.id])]
        made = self.text(value)
        if made.kind not in self.unit.kinds:
            refuse(value, "no tuple")
        name = made.text
        if not isinstance(value, ast.Name):
            self.results += 1
            name = f"found{self.results}"
            fresh.append((f"const {made.kind}", f"{name} = {made.text}"))
        dot = "->" if name in self.pointers else "."
        kinds, fields = self.unit.kinds[made.kind], self.unit.names[made.kind]
        return [_Text(f"{name}{dot}{field}", kind) for field, kind in zip(fields, kinds, strict=True)]

    def taken_as(self, name: str) -> str:
        """Return what the functions that `name` is passed to call it; "" if it is passed to none."""
        for call in ast.walk(self.function):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id in self.unit.printed:
                arguments = _arguments(self.unit.source.functions[call.func.id])
                for argument, given in zip(arguments, call.args, strict=False):
                    if isinstance(given, ast.Name) and given.id == name:
                        return argument
        return ""

    def result(self, value: ast.expr) -> str:
        """Return what is returned, and remember of what type it is."""
        if isinstance(value, ast.Tuple):
            names = [e.id for e in value.elts if isinstance(e, ast.Name)]
            if len(names) != len(value.elts):
                refuse(value, "only names can be returned in a tuple")
            kinds = [self.text(e).kind for e in value.elts]
            kind = self.unit.struct(f"ant_{self.function.name}", names, kinds, f"What {self.function.name} returns.")
            made = _Text(f"({kind}){{{', '.join(names)}}}", kind)
        else:
            made = self.text(value)
        if self.returned and self.returned != made.kind:
            refuse(value, f"{made.kind} is returned, and {self.returned} elsewhere")
        self.returned = made.kind
        return made.text

    # --- expressions

    def text(self, node: ast.expr) -> _Text:
        """Return C's text of the expression `node`."""
        match node:
            case ast.Name(name):
                return _Text(name, self.kinds[name]) if name in self.kinds else self.unit.constant(node)
            case ast.Constant(bool() | int() | float() as value):
                return _literal(value)
            case ast.UnaryOp(ast.USub(), operand):
                inner = self.text(operand)
                return _Text(f"-{inner.above(_UNARY + inner.text.startswith('-') * _ATOM)}", inner.kind, _UNARY)
            case ast.UnaryOp(ast.Not(), operand):
                return _Text(f"!{self.text(operand).above(_UNARY)}", INT, _UNARY)
            case ast.BinOp(left, op, right):
                return self.binary(node, self.text(left), op, self.text(right))
            case ast.BoolOp(op, values):
                sign, level = (" && ", _AND) if isinstance(op, ast.And) else (" || ", _OR)
                return _Text(sign.join(self.text(value).above(_LINK) for value in values), INT, level)
            case ast.Compare():
                return self.comparison(node)
            case ast.IfExp(test, body, orelse):
                return self.choice(test, body, orelse)
            case ast.Call(ast.Name(name), arguments):
                return self.call(node, name, arguments)
        refuse(node)

    def binary(self, node: ast.BinOp, left: _Text, op: ast.operator, right: _Text) -> _Text:
        """Return a sum, a product or a combination of flags."""
        kind = INT if left.kind == right.kind == INT else REAL
        if {left.kind, right.kind} - {INT, REAL}:
            refuse(node, "a tuple")
        if isinstance(op, ast.BitOr):
            if kind != INT:
                refuse(node, "no flags")
            first = left.text if " | " in left.text and left.level == _FLAGS else left.above(_UNARY)
            return _Text(f"{first} | {right.above(_UNARY)}", INT, _FLAGS)
        sign, level = _SIGNS[type(op)]
        if isinstance(op, ast.Div) and kind == INT:
            left, kind = _Text(f"({REAL}){left.above(_UNARY)}", REAL, _UNARY), REAL
        return _Text(f"{left.above(level)} {sign} {right.above(level + 1)}", kind, level)

    def comparison(self, node: ast.Compare) -> _Text:
        """Return a chain of comparisons, or the test that an argument is None."""
        if name := asks_for_none(node):
            if name not in self.unit.outside.absent:
                refuse(node, "C has no None")
            return _Text(self.unit.outside.absent[name], INT, _LINK)
        if not all(type(op) in _LINKS for op in node.ops):
            refuse(node)
        operands = [self.text(operand).above(_SUM) for operand in (node.left, *node.comparators)]
        signs = [_LINKS[type(op)] for op in node.ops]
        links = [f"{a} {sign} {b}" for a, sign, b in zip(operands, signs, operands[1:], strict=False)]
        return _Text(" && ".join(links), INT, _AND if len(links) > 1 else _LINK)

    def choice(self, test: ast.expr, body: ast.expr, orelse: ast.expr) -> _Text:
        """Return a conditional expression; one of its sides if it is known which."""
        if asks_for_none(test) in self.unit.outside.none:
            return self.text(body)
        yes, no = self.text(body), self.text(orelse)
        if yes.kind != no.kind and {yes.kind, no.kind} != {INT, REAL}:
            refuse(body, f"{yes.kind} or {no.kind}")
        kind = yes.kind if yes.kind == no.kind else REAL
        return _Text(f"{self.text(test).above(_OR)} ? {yes.above(_OR)} : {no.above(_CHOICE)}", kind, _CHOICE)

    def call(self, node: ast.Call, name: str, arguments: list[ast.expr]) -> _Text:
        """Return a call, of a printed function or of one that C has."""
        if name not in self.unit.printed:
            known = {**_MADE, **self.unit.outside.names}
            if name not in known:
                refuse(node, "C has no such function")
            return _Text(f"{known[name]}({', '.join(self.text(a).text for a in arguments)})", REAL)
        names = _arguments(self.unit.source.functions[name])
        if len(names) != len(arguments):
            refuse(node, "arguments are missing")
        made = [self.argument(given, taken) for given, taken in zip(arguments, names, strict=True)]
        kind = self.unit.function(name, [one.kind for one in made])
        return _Text(f"{self.unit.called(name)}({', '.join(map(self.passed, made))})", kind)

    def argument(self, given: ast.expr, taken: str) -> _Text:
        """Return `given`, which the function called calls `taken`."""
        if isinstance(given, ast.Tuple):
            return self.tuple(given, taken)
        if isinstance(given, ast.Name) and isinstance(self.unit.source.names.get(given.id), tuple):
            return self.unit.constant_struct(given, taken) if given.id not in self.kinds else self.text(given)
        return self.text(given)

    def passed(self, argument: _Text) -> str:
        """Return how `argument` is passed: structs by their address."""
        if argument.kind not in self.unit.kinds or argument.text in self.pointers:
            return argument.text
        cast = f"({argument.kind})" if argument.text.startswith("{") else ""
        return f"&{cast}{argument.text}"

    def tuple(self, value: ast.Tuple, name: str) -> _Text:
        """Return the struct that holds `value`, called as the argument `name`."""
        made = [self.text(element) for element in value.elts]
        return _Text(f"{{{', '.join(one.text for one in made)}}}", self.unit.struct_of(value, name, made))


def _literal(value: float) -> _Text:
    if isinstance(value, int):
        return _Text(str(int(value)), INT)
    return _Text(f"ANT_R({value!r})", REAL)


def _runs(pairs: Any) -> Iterator[tuple[str, list[str]]]:
    """Yield (key, values of all pairs in a row that begin with it)."""
    for key, group in groupby(pairs, key=lambda pair: pair[0]):
        yield key, [value for _, value in group]


def _whole(text: str) -> str:
    """Return `text` so that `_wrapped` keeps it in a line, if it fits into one."""
    return text.replace(" ", "\0") if len(text) < _WIDTH - 12 else text


def _wrapped(line: str, depth: int) -> list[str]:
    """Return `line` in as many lines as it takes."""
    first, later = "    " * depth, "    " * (depth + 1)
    width, options = _WIDTH, {"break_long_words": False, "break_on_hyphens": False}
    lines = textwrap.wrap(line, width, initial_indent=first, subsequent_indent=later, **options)  # type: ignore[arg-type]  # both are bool
    return [line.replace("\0", " ") for line in lines]


def _comment(text: str, depth: int) -> str:
    """Return `text` as a comment, of which what is indented stays as it is."""
    indent = "    " * depth
    lines: list[str] = []
    for paragraph in text.translate(_ASCII).split("\n\n"):
        kept = paragraph.startswith(" ")
        lines += ["", *(paragraph.split("\n") if kept else textwrap.wrap(paragraph, _WIDTH - 6 - len(indent)))]
    between = f"\n{indent} * "
    return f"{indent}/* {between.join(lines[1:])} */".replace(" \n", "\n")


__all__ = ["INT", "REAL", "Outside", "Printed", "c_form"]
