"""Functions of plain Python that fill arrays, such as the kernel of mechanisms, are printed here as C99 without a heap.

They have what numba compiles without asking: numbers, arrays, named tuples of arrays, loops over `range`, branches,
each other, `abs`, `min`, `max`, `sqrt` and `len`. A named tuple is a struct; an array's sizes are known when C is
compiled. What a name stands for as an argument, `Kinds` says once for all functions; of other variables the assigned
values tell whether they are real. Whatever else there is raises `Unprintable`.
"""

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, NoReturn, TypeAlias

from allocator.allocation.kernels.printer import Unprintable
from allocator.allocation.kernels.printer.c_layout import comment, wrapped
from mpc.codegen.c_text import number

REAL, INT = "ant_real", "int"


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
    """A `StructKind` is the struct in the place of a named tuple: of arrays, or of pointers to them."""

    name: str
    fields: Mapping[str, ArrayKind]
    holds: bool  # whether the arrays are in it

    def definition(self) -> str:
        """Return its typedef."""
        lines = [kind.memory(name) if self.holds else kind.argument(name) for name, kind in self.fields.items()]
        return "\n".join(["typedef struct {", *(f"    {line};" for line in lines), f"}} {self.name};"])

    def argument(self, name: str) -> str:
        """Return the declaration of `name` as a pointer to it."""
        return f"{self.name} *{name}" if self.holds else f"const {self.name} *{name}"


Kind: TypeAlias = str | ArrayKind | StructKind
Kinds: TypeAlias = Mapping[str, Kind]
"""What the arguments of a name are, in all functions: arrays and structs; what is not here is an int."""


class Printed(NamedTuple):
    """`Printed` are the prototypes of the functions for others, and the text of all."""

    head: str
    body: str


def c_functions(
    functions: Sequence[Callable[..., Any]],
    kinds: Kinds,
    single: bool,
    entries: Mapping[str, str],
    numbers: Mapping[str, float],
) -> Printed:
    """Return C's text of `functions`, of which `entries` are for others, under these names.

    `numbers` has what global names stand for where it is not Python's value. Raises `Unprintable`.
    """
    unit = _Unit(functions, kinds, single, entries, numbers)
    bodies = [unit.function(function.__name__) for function in functions]
    heads = {name: unit.heads[name] for name in unit.heads}
    own = [_prototype(head) for name, head in heads.items() if name not in entries]
    constants = [f"#define {name} {text}" for name, text in unit.constants.items()]
    head = "\n".join(_prototype(heads[name]) for name in entries)
    return Printed(head, "\n\n".join(["\n".join(constants), "\n".join(own), *bodies]))


def _prototype(head: str) -> str:
    return "\n".join(wrapped(f"{head};", 0))


class _Unit:
    """The text under way: what functions return, and which constants they ask for."""

    def __init__(
        self,
        functions: Sequence[Callable[..., Any]],
        kinds: Kinds,
        single: bool,
        entries: Mapping[str, str],
        numbers: Mapping[str, float],
    ) -> None:
        self.kinds, self.single, self.entries, self.numbers = kinds, single, entries, numbers
        self.nodes = {f.__name__: _parsed(f) for f in functions}
        self.names: dict[str, Any] = {}
        for f in functions:
            self.names |= f.__globals__  # a global name means the same in all of them
        self.constants: dict[str, str] = {}
        self.heads: dict[str, str] = {}
        self.returns: dict[str, str] = {}

    def function(self, name: str) -> str:
        """Return the text of a function, and remember its head."""
        made = _Function(self, self.nodes[name])
        text = "\n".join(made.lines())
        self.heads[name] = made.head
        return text

    def returned(self, name: str) -> str:
        """Return what kind of number the function `name` returns, "void" for none."""
        if name not in self.returns:
            self.returns[name] = INT  # while it is looked at
            self.returns[name] = _Function(self, self.nodes[name]).result()
        return self.returns[name]

    def literal(self, value: float) -> str:
        """Return a number."""
        return str(int(value)) if isinstance(value, int) else number(value, self.single)

    def constant(self, node: ast.Name) -> str:
        """Return the name of a global number, which is defined."""
        value = self.numbers.get(node.id, self.names.get(node.id))
        if not isinstance(value, int | float):
            _refuse(node, "no number")
        self.constants[f"ANT_{node.id}"] = self.literal(value)
        return f"ANT_{node.id}"


_LINKS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_SIGNS = {ast.Add: ("+", 12), ast.Sub: ("-", 12), ast.Mult: ("*", 13), ast.Div: ("/", 13)}
_ATOM, _UNARY, _SUM, _LINK, _AND, _OR, _CHOICE = 16, 14, 12, 10, 5, 4, 3  # how strongly C's operators bind


class _Function:
    """One function: its variables, and its text line by line."""

    def __init__(self, unit: _Unit, node: ast.FunctionDef) -> None:
        self.unit, self.node = unit, node
        self.arguments = [argument.arg for argument in node.args.args]
        self.known: dict[str, Kind] = {name: unit.kinds.get(name, INT) for name in self.arguments}
        self.loops = {n.target.id for n in ast.walk(node) if isinstance(n, ast.For) and isinstance(n.target, ast.Name)}
        self.local: dict[str, Kind] = {}
        sized = {id(n.args[0]) for n in ast.walk(node) if isinstance(n, ast.Call) and ast.unparse(n.func) == "len"}
        loaded = [n for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)]
        self.read = {n.id for n in loaded if id(n) not in sized}  # C does not ask an array for its length
        self.head = ""
        self.fresh: set[str] = set()  # variables that are declared where they are first assigned
        for _ in range(3):  # until what is assigned is known of all
            for target, value in self.assigned():
                if isinstance(target, ast.Name) and target.id in self.loops:
                    _refuse(node, f"{target.id} is the variable of a loop, too")
                self.note(target, self.kind(value))

    def assigned(self) -> Iterator[tuple[ast.expr, ast.expr]]:
        """Yield all targets with their values."""
        for node in ast.walk(self.node):
            if isinstance(node, ast.Assign):
                yield from _pairs(node)
            elif isinstance(node, ast.AugAssign):
                yield node.target, node.value

    def note(self, target: ast.expr, kind: Kind) -> None:
        """Remember of what kind a local variable is; one that is ever real is real."""
        if not isinstance(target, ast.Name) or target.id in self.known:
            return
        if self.local.get(target.id) != REAL:
            self.local[target.id] = kind

    # --- what kind of value an expression has

    def kind(self, node: ast.expr) -> Kind:
        """Return the kind of an expression."""
        match node:
            case ast.Constant(value):
                return REAL if isinstance(value, float) else INT
            case ast.Name(name):
                return self.of_name(node, name)
            case ast.Attribute(ast.Name(name), field):
                struct = self.known.get(name)
                return struct.fields[field] if isinstance(struct, StructKind) else _refuse(node, "no struct")
            case ast.Subscript(ast.Attribute(_, "shape"), _):
                return INT
            case ast.Subscript(array, _):
                kind = self.kind(array)
                element = kind.element if isinstance(kind, ArrayKind) else _refuse(node, "no array")
                return REAL if element == REAL else INT
            case ast.BinOp(left, ast.Div(), right):
                return REAL
            case ast.BinOp(left, _, right) | ast.IfExp(_, left, right):
                return REAL if REAL in (self.kind(left), self.kind(right)) else INT
            case ast.UnaryOp(ast.USub(), operand):
                return self.kind(operand)
            case ast.Call(ast.Name("sqrt"), _):
                return REAL
            case ast.Call(ast.Name("abs" | "min" | "max"), arguments):
                return REAL if REAL in map(self.kind, arguments) else INT
            case ast.Call(ast.Name(name), _) if name in self.unit.nodes:
                return self.unit.returned(name)
        return INT

    def of_name(self, node: ast.Name, name: str) -> Kind:
        """Return the kind of a variable or a constant."""
        if name in self.known or name in self.local:
            return self.known.get(name) or self.local[name]
        return REAL if isinstance(self.unit.names.get(name), float) else INT

    def result(self) -> str:
        """Return the kind of number that is returned."""
        values = [node.value for node in ast.walk(self.node) if isinstance(node, ast.Return) and node.value]
        return "void" if not values else REAL if REAL in map(self.kind, values) else INT

    # --- text

    def lines(self) -> Iterator[str]:
        """Yield the lines of the function."""
        given = [_declared(name, kind) for name, kind in self.known.items()]
        name = self.unit.entries.get(self.node.name, self.node.name)
        static = "" if self.node.name in self.unit.entries else "static "
        self.head = f"{static}{self.unit.returned(self.node.name)} {name}({', '.join(given)})"
        body = self.node.body[1:] if ast.get_docstring(self.node) else self.node.body
        if doc := ast.get_docstring(self.node):
            yield comment(doc, 0)
        yield from wrapped(f"{self.head} {{", 0)
        yield from (f"    (void){name};" for name in self.known if name not in self.read)
        self.fresh = set(_first_assigned(body)) & set(self.local)
        later = ((name, kind) for name, kind in self.local.items() if name in self.read - self.fresh)
        yield from (f"    {_declared(name, kind)};" for name, kind in later)
        yield from self.block(body, 1)
        yield "}"

    def block(self, block: Sequence[ast.stmt], depth: int) -> Iterator[str]:
        """Yield the lines of statements."""
        pad = "    " * depth
        for node in block:
            match node:
                case ast.Assign():
                    pairs = list(_pairs(node))
                    _check_order(node, pairs)
                    for target, value in pairs:
                        if isinstance(target, ast.Name) and target.id not in self.read:
                            continue
                        yield from wrapped(f"{self.target(target)} = {self.text(value)};", depth)
                case ast.AugAssign(target, op, value):
                    yield from wrapped(f"{self.text(target)} {_SIGNS[type(op)][0]}= {self.text(value)};", depth)
                case ast.Return(value):
                    yield from wrapped(f"return{f' {self.text(value)}' if value else ''};", depth)
                case ast.Expr(ast.Call() as call):
                    yield from wrapped(f"{self.text(call)};", depth)
                case ast.Break() | ast.Continue():
                    yield f"{pad}{'break' if isinstance(node, ast.Break) else 'continue'};"
                case ast.For(ast.Name(name), ast.Call(ast.Name("range"), bounds), body, []):
                    yield f"{pad}for ({self.loop(name, bounds)}) {{"
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
                    _refuse(node)

    def target(self, node: ast.expr) -> str:
        """Return what is assigned to; a variable that is new is declared."""
        if isinstance(node, ast.Name) and node.id in self.fresh:
            self.fresh.remove(node.id)
            return _declared(node.id, self.local[node.id])
        return self.text(node)

    def loop(self, name: str, bounds: Sequence[ast.expr]) -> str:
        """Return what stands in the head of a loop over `range(*bounds)`."""
        begin, end = (ast.Constant(0), bounds[0]) if len(bounds) == 1 else bounds[:2]
        down = len(bounds) == 3
        if down and ast.unparse(bounds[2]) != "-1":
            _refuse(bounds[2], "a step other than -1")
        sign, step = (">", "--") if down else ("<", "++")
        return f"int {name} = {self.text(begin)}; {name} {sign} {self.text(end, _SUM)}; {name}{step}"

    def text(self, node: ast.expr, least: int = 0) -> str:
        """Return an expression, in parentheses unless its operator binds at least as strongly as `least`."""
        text, level = self.expression(node)
        return text if level >= least else f"({text})"

    def expression(self, node: ast.expr) -> tuple[str, int]:
        """Return the text of an expression, and how strongly its operator binds."""
        match node:
            case ast.Constant(bool() | int() | float() as value):
                return self.unit.literal(value), _ATOM
            case ast.Name(name):
                mine = name in self.known or name in self.local or name in self.loops
                return (name if mine else self.unit.constant(node)), _ATOM
            case ast.Attribute(ast.Name(name), field):
                return f"{name}->{field}", _ATOM
            case ast.Subscript(ast.Attribute(array, "shape"), ast.Constant(int() as axis)):
                return self.sizes(array)[axis], _ATOM
            case ast.Subscript(array, ast.Tuple(places)):
                return self.text(array, _ATOM) + "".join(f"[{self.text(place)}]" for place in places), _ATOM
            case ast.Subscript(array, place):
                return f"{self.text(array, _ATOM)}[{self.text(place)}]", _ATOM
            case ast.UnaryOp(ast.USub(), operand):
                return f"-{self.text(operand, _UNARY)}", _UNARY
            case ast.UnaryOp(ast.Not(), operand):
                return f"!{self.text(operand, _UNARY)}", _UNARY
            case ast.BinOp(left, op, right) if type(op) in _SIGNS:
                sign, level = _SIGNS[type(op)]
                return f"{self.text(left, level)} {sign} {self.text(right, level + 1)}", level
            case ast.Compare(left, [op], [right]) if type(op) in _LINKS:
                return f"{self.text(left, _SUM)} {_LINKS[type(op)]} {self.text(right, _SUM)}", _LINK
            case ast.BoolOp(op, values):
                sign, level = (" && ", _AND) if isinstance(op, ast.And) else (" || ", _OR)
                return sign.join(self.text(value, _LINK) for value in values), level
            case ast.IfExp(test, yes, no):
                return f"{self.text(test, _OR)} ? {self.text(yes, _OR)} : {self.text(no, _SUM)}", _CHOICE
            case ast.Call(ast.Name(name), arguments):
                return self.call(node, name, arguments), _ATOM
        _refuse(node)

    def sizes(self, node: ast.expr) -> tuple[str, ...]:
        """Return the sizes of an array."""
        kind = self.kind(node)
        return kind.sizes if isinstance(kind, ArrayKind) else _refuse(node, "no array")

    def call(self, node: ast.Call, name: str, arguments: Sequence[ast.expr]) -> str:
        """Return a call."""
        if name == "len":
            return self.sizes(arguments[0])[0]
        whole = "_int" if self.kind(node) == INT else ""
        made = {"abs": f"ant_abs{whole}", "min": f"ant_min{whole}", "max": f"ant_max{whole}", "sqrt": "ANT_F(sqrt)"}
        called = made.get(name) or (self.unit.entries.get(name, name) if name in self.unit.nodes else "")
        if not called or node.keywords:
            _refuse(node, "C has no such function")
        return f"{called}({', '.join(map(self.text, arguments))})"


def _parsed(function: Callable[..., Any]) -> ast.FunctionDef:
    [node] = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    if not isinstance(node, ast.FunctionDef):
        raise Unprintable(f"{function} is no function")
    return node


def _pairs(node: ast.Assign) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Yield (target, value), one by one where a tuple is assigned to a tuple."""
    if len(node.targets) != 1:
        _refuse(node, "two targets")
    match node.targets[0], node.value:
        case ast.Tuple(targets), ast.Tuple(values) if len(targets) == len(values):
            yield from zip(targets, values, strict=True)
        case ast.Tuple(), _:
            _refuse(node, "a tuple that is none")
        case target, value:
            yield target, value


def _first_assigned(body: Sequence[ast.stmt]) -> Iterator[str]:
    """Yield the variables that are first assigned in `body` itself, not in its loops and branches."""
    seen: set[str] = set()
    for statement in body:
        stored = [n.id for n in ast.walk(statement) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
        if isinstance(statement, ast.Assign):
            yield from (name for name in stored if name not in seen)
        seen |= set(stored)


def _check_order(node: ast.Assign, pairs: Sequence[tuple[ast.expr, ast.expr]]) -> None:
    """Refuse a value that asks for what has been assigned just before: C assigns one after the other."""
    for i, (target, _) in enumerate(pairs):
        if any(ast.unparse(target) in map(ast.unparse, ast.walk(value)) for _, value in pairs[i + 1 :]):
            _refuse(node, "a value asks for a name that has just been assigned")


def _declared(name: str, kind: Kind) -> str:
    return f"{kind} {name}" if isinstance(kind, str) else kind.argument(name)


def _refuse(node: ast.AST, why: str = "") -> NoReturn:
    reason = f" ({why})" if why else ""
    raise Unprintable(f"line {getattr(node, 'lineno', '?')} cannot be printed{reason}: {ast.unparse(node)}")


__all__ = ["INT", "REAL", "ArrayKind", "Kinds", "Printed", "StructKind", "c_functions"]
