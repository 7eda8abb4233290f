"""Source text of the functions to be printed, checked for constructs that the printer supports.

Such functions use numbers, tuples of numbers and each other; the table in `printer` lists the permitted constructs.
"""

import ast
import inspect
import io
import tokenize
from collections.abc import Iterator, Mapping
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
    """Unsupported construct; the message shows it and gives its line."""


class Source(NamedTuple):
    """Source text of a module: its functions, and the values of its global names."""

    text: str
    functions: dict[str, ast.FunctionDef]
    names: Mapping[str, Any]

    @classmethod
    def of(cls, module: ModuleType) -> "Source":
        """Return the text of `module`."""
        return cls.parsed(inspect.getsource(module), vars(module))

    @classmethod
    def parsed(cls, text: str, names: Mapping[str, Any]) -> "Source":
        """Return the source `text` with `names` as values of global names."""
        functions = {node.name: node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)}
        return cls(text, functions, names)

    def comments(self) -> dict[int, str]:
        """Return the comments by line."""
        tokens = tokenize.generate_tokens(io.StringIO(self.text).readline)
        return {t.start[0]: t.string.lstrip("# ") for t in tokens if t.type == tokenize.COMMENT}

    def reached(self, entry: str) -> list[str]:
        """Return `entry` and all functions that it calls, callees first.

        Raises Unprintable for constructs that neither form supports.
        """
        found: list[str] = []
        self._reach(entry, found)
        return found

    def _reach(self, entry: str, found: list[str]) -> None:
        for called in dict.fromkeys(self._checked(entry)):
            if called not in found:
                self._reach(called, found)
        found.append(entry)

    def _checked(self, name: str) -> Iterator[str]:
        """Check the function `name`, and yield those that it calls."""
        nodes = [inner for statement in statements(self.functions[name]) for inner in ast.walk(statement)]
        if strange := next((node for node in nodes if not isinstance(node, _KNOWN)), None):
            refuse(next(node for node in reversed(nodes) if strange in ast.walk(node) and hasattr(node, "lineno")))
        for node in nodes:
            if isinstance(node, ast.Compare) and ast.Is in map(type, node.ops) and not asks_for_none(node):
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
    """Return the name that `test` compares with None; None for any other test."""
    match test:
        case ast.Compare(ast.Name(name), [ast.Is()], [ast.Constant(None)]):
            return name
    return None


def assignments(statement: ast.Assign) -> list[tuple[ast.expr, ast.expr]]:
    """Return the (target, value) pairs of `statement`, one per element if a tuple is assigned to a tuple.

    `x, y = (a, b) if test else (c, d)` assigns a or c to x. They are assigned in order: no value may read a name
    assigned just before.
    """
    if len(statement.targets) != 1:
        refuse(statement, "two targets")
    found = list(_pairs(statement.targets[0], statement.value))
    new: set[str] = set()
    for target, value in found:
        if new & names_in(value):
            refuse(statement, "a value asks for a name that has just been assigned")
        new |= names_in(target)
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


def names_in(node: ast.AST) -> set[str]:
    """Return all names in `node`."""
    return {inner.id for inner in ast.walk(node) if isinstance(inner, ast.Name) and inner.id != "_"}
