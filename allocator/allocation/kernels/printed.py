"""The printer takes functions of plain Python, such as the kernels of `source`, and prints them for NumPy and as C99.

Such functions know numbers and tuples of numbers, and what numba compiles into code without branches:

    Python                              NumPy                           C (`printed_c`)
    + - * / and | of flags              as it stands                    as it stands
    a if test else b                    np.where(test, a, b)            test ? a : b
    not a, a and b, a or b              np.logical_not(a), …            !a, a && b, a || b
    a < b < c                           np.logical_and(a < b, b < c)    a < b && b < c
    a if x is None else b               as it stands                    the test that stands for it, or a or b alone
    if test: x = a                      x = np.where(test, a, x)        as it stands
    if test: return a                   the rest, where it is not so    as it stands
    x, y, z = box                       as it stands                    fields of a struct, which has these names
    return x, y                         as it stands                    a struct of x and y
    for _ in range(4): …                as it stands                    a loop
    abs(x), sqrt(x), f(x)               np.abs(x), np.sqrt(x), f(x)     what C calls them

Whatever else there is raises `Unprintable`, whichever form is asked for.
"""

import ast
import inspect
import io
import tokenize
from copy import deepcopy
from collections.abc import Callable, Iterable, Iterator, Mapping
from types import ModuleType
from typing import Any, NamedTuple, NoReturn

from allocator.errors import AntagonistError

_KNOWN = (
    *(ast.Assign, ast.If, ast.For, ast.Return, ast.Name, ast.Constant, ast.Tuple, ast.IfExp, ast.Call),
    *(ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.BitOr, ast.UnaryOp, ast.USub, ast.Not),
    *(ast.BoolOp, ast.And, ast.Or, ast.Compare, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq, ast.Is),
    *(ast.Load, ast.Store),
)


class Unprintable(AntagonistError):
    """A construct that the printer does not know; the message shows it and tells its line."""


class Source(NamedTuple):
    """The text to be printed is that of a module: its functions, and what its names stand for."""

    text: str
    functions: dict[str, ast.FunctionDef]
    names: Mapping[str, Any]

    @classmethod
    def of(cls, module: ModuleType) -> "Source":
        """Return the text of `module`."""
        return cls.parsed(inspect.getsource(module), vars(module))

    @classmethod
    def parsed(cls, text: str, names: Mapping[str, Any]) -> "Source":
        """Return `text`, in which global names stand for `names`."""
        functions = {node.name: node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)}
        return cls(text, functions, names)

    def comments(self) -> dict[int, str]:
        """Return what is said behind `#`, by line."""
        tokens = tokenize.generate_tokens(io.StringIO(self.text).readline)
        return {t.start[0]: t.string.lstrip("# ") for t in tokens if t.type == tokenize.COMMENT}

    def reached(self, entry: str) -> list[str]:
        """Return all functions that `entry` calls, each behind those that it calls itself, and `entry`.

        Raises Unprintable for what none of the forms has.
        """
        found: list[str] = []
        for call in self._checked(entry):
            found += [name for name in self.reached(call) if name not in found]
        return [*found, entry]

    def _checked(self, name: str) -> Iterator[str]:
        """Check the function `name`, and yield those that it calls."""
        for node in (inner for statement in statements(self.functions[name]) for inner in ast.walk(statement)):
            if not isinstance(node, _KNOWN):
                refuse(node)
            if isinstance(node, ast.Call):
                if not isinstance(node.func, ast.Name) or node.keywords:
                    refuse(node)
                if node.func.id in self.functions:
                    yield node.func.id


def refuse(node: ast.AST, why: str = "") -> NoReturn:
    """Raise Unprintable for `node`."""
    reason = f" ({why})" if why else ""
    raise Unprintable(f"line {getattr(node, 'lineno', '?')} cannot be printed{reason}: {ast.unparse(node)}")


def statements(function: ast.FunctionDef) -> list[ast.stmt]:
    """Return the statements of `function` without its docstring."""
    return function.body[1:] if ast.get_docstring(function) is not None else function.body


def asks_for_none(test: ast.expr) -> str | None:
    """Return the name that `test` asks whether it is None; None if it asks anything else."""
    match test:
        case ast.Compare(ast.Name(name), [ast.Is()], [ast.Constant(None)]):
            return name
    return None


def assignments(statement: ast.Assign) -> list[tuple[ast.expr, ast.expr]]:
    """Return (target, value) of what `statement` assigns, one by one where a tuple is assigned to a tuple.

    `x, y = (a, b) if test else (c, d)` assigns a or c to x. One by one means one after the other: no value may ask for
    a name that has just been assigned.
    """
    if len(statement.targets) != 1:
        refuse(statement, "two targets")
    found = list(_pairs(statement.targets[0], statement.value))
    new: set[str] = set()
    for target, value in found:
        if new & _names(value):
            refuse(statement, "a value asks for a name that has just been assigned")
        new |= _names(target)
    return found


def _pairs(target: ast.expr, value: ast.expr) -> Iterator[tuple[ast.expr, ast.expr]]:
    match target, value:
        case ast.Tuple(names), ast.Tuple(values) if len(names) == len(values):
            for one, its in zip(names, values, strict=True):
                yield from _pairs(one, its)
        case ast.Tuple(names), ast.IfExp(test, ast.Tuple(yes), ast.Tuple(no)) if len(names) == len(yes) == len(no):
            for one, a, b in zip(names, yes, no, strict=True):
                yield from _pairs(one, ast.copy_location(ast.IfExp(test, a, b), value))
        case _:
            yield target, value


def _names(node: ast.AST) -> set[str]:
    return {inner.id for inner in ast.walk(node) if isinstance(inner, ast.Name) and inner.id != "_"}


# --- NumPy ----------------------------------------------------------------------------------------------------------


def array_form(source: Source, entry: str) -> str:
    """Return Python's text of `entry`, and of what it calls, for arrays in the place of numbers."""
    return "\n\n".join(_array_function(source.functions[name]) for name in source.reached(entry))


def array_function(source: Source, entry: str) -> Callable[..., Any]:
    """Return `entry` for arrays; it is called as it was, and warns of what lies in the branches not taken."""
    import numpy as np

    space: dict[str, Any] = {**source.names, "np": np, "abs": np.abs, "sqrt": np.sqrt}
    exec(compile(array_form(source, entry), f"<{entry} for arrays>", "exec"), space)
    made: Callable[..., Any] = space[entry]
    return made


def _array_function(function: ast.FunctionDef) -> str:
    known = {argument.arg for argument in function.args.args}
    body = _array_block(deepcopy(statements(function)), known)
    made = ast.FunctionDef(function.name, function.args, body, [], None)
    return ast.unparse(ast.fix_missing_locations(made))


def _array_block(block: list[ast.stmt], known: set[str]) -> list[ast.stmt]:
    done: list[ast.stmt] = []
    for i, statement in enumerate(block):
        match statement:
            case ast.If(test, [ast.Return(ast.expr() as early)], []) if not asks_for_none(test):
                rest = _array_block(block[i + 1 :], known)
                if not rest or not isinstance(last := rest[-1], ast.Return) or last.value is None:
                    refuse(statement, "nothing is returned otherwise")
                before = [_stored(f"_test{i}", _Arrays().visit(test)), _stored(f"_early{i}", _Arrays().visit(early))]
                return [*done, *before, *rest[:-1], ast.Return(_where(f"_test{i}", _load(f"_early{i}"), last.value))]
            case ast.If(test, body, orelse) if not asks_for_none(test):
                done.append(_stored(f"_test{i}", _Arrays().visit(test)))
                done += _chosen(f"_test{i}", body, orelse, known)
            case ast.If(test, body, orelse):
                done.append(ast.If(test, _array_block(body, known), _array_block(orelse, known)))
            case ast.For(target, ast.Call(ast.Name("range"), [_]) as count, body, []):
                done.append(ast.For(target, count, _array_block(body, known), []))
            case ast.Assign():
                assignments(statement)
                known |= {name for target in statement.targets for name in _names(target)}
                done.append(_Arrays().visit(statement))
            case ast.Return(ast.expr()):
                done.append(_Arrays().visit(statement))
            case _:
                refuse(statement)
    return done


def _chosen(test: str, body: list[ast.stmt], orelse: list[ast.stmt], known: set[str]) -> Iterator[ast.stmt]:
    """Yield assignments that take place where `test` holds, and those that do where it does not."""
    for statement, holds in (*((s, True) for s in body), *((s, False) for s in orelse)):
        if not isinstance(statement, ast.Assign):
            refuse(statement, "in a branch")
        for target, value in assignments(statement):
            if not isinstance(target, ast.Name) or target.id not in known:
                refuse(statement, "first assigned in a branch")
            new, old = _Arrays().visit(value), _load(target.id)
            yield _stored(target.id, _where(test, new, old) if holds else _where(test, old, new))


def _load(name: str) -> ast.expr:
    return ast.Name(name, ast.Load())


def _stored(name: str, value: ast.expr) -> ast.stmt:
    return ast.Assign([ast.Name(name, ast.Store())], value)


def _where(test: str | ast.expr, yes: ast.expr, no: ast.expr) -> ast.expr:
    return _numpy("where", [_load(test) if isinstance(test, str) else test, yes, no])


def _numpy(function: str, arguments: Iterable[ast.expr]) -> ast.expr:
    return ast.Call(ast.Attribute(_load("np"), function, ast.Load()), list(arguments), [])


class _Arrays(ast.NodeTransformer):
    """The transformer turns an expression of numbers into one of arrays."""

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        """Choose one by one, but ask for None once."""
        if asks_for_none(node.test):
            return ast.IfExp(node.test, self.visit(node.body), self.visit(node.orelse))
        test, yes, no = (self.visit(part) for part in (node.test, node.body, node.orelse))
        match yes, no:
            case ast.Tuple(one), ast.Tuple(other) if len(one) == len(other):
                return ast.Tuple([_where(test, a, b) for a, b in zip(one, other, strict=True)], ast.Load())
        return _where(test, yes, no)

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        """Combine truth values one by one."""
        first, *others = map(self.visit, node.values)
        for other in others:
            first = _numpy("logical_and" if isinstance(node.op, ast.And) else "logical_or", [first, other])
        return first  # type: ignore[no-any-return]  # visit returns what it likes

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        """Negate truth values one by one."""
        operand = self.visit(node.operand)
        return _numpy("logical_not", [operand]) if isinstance(node.op, ast.Not) else ast.UnaryOp(node.op, operand)

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        """Compare one by one, each link of a chain by itself."""
        operands = [self.visit(operand) for operand in (node.left, *node.comparators)]
        links = [ast.Compare(a, [op], [b]) for a, op, b in zip(operands, node.ops, operands[1:], strict=False)]
        first: ast.expr = links[0]
        for link in links[1:]:
            first = _numpy("logical_and", [first, link])
        return first


__all__ = [
    "Source",
    "Unprintable",
    "array_form",
    "array_function",
    "asks_for_none",
    "assignments",
    "refuse",
    "statements",
]
