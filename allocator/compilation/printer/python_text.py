"""Source text of the functions to be printed, checked for constructs that the printer supports.

Such functions use numbers, tuples of numbers and each other; the table in `printer` lists the permitted constructs.

Python without a counterpart in C, rewritten in terms that have one.
"""

import ast
import inspect
import io
import tokenize
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any, NamedTuple, NoReturn, TypeVar

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


N = TypeVar("N", bound=ast.AST)


class _Simple(ast.NodeTransformer):
    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        """Return a ≤ b ≤ c as a ≤ b and b ≤ c."""
        self.generic_visit(node)
        if len(node.ops) == 1:
            return node
        sides = [node.left, *node.comparators]
        links = zip(sides, node.ops, sides[1:], strict=False)
        return _at(node, ast.BoolOp(ast.And(), [ast.Compare(left, [op], [right]) for left, op, right in links]))

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        """Return x ** 2 and x ** 3 as products."""
        self.generic_visit(node)
        match node:
            case ast.BinOp(base, ast.Pow(), ast.Constant(2)):
                return _at(node, ast.BinOp(base, ast.Mult(), base))
            case ast.BinOp(base, ast.Pow(), ast.Constant(3)):
                return _at(node, ast.BinOp(ast.BinOp(base, ast.Mult(), base), ast.Mult(), base))
        return node

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """Return float(x) and bool(x) as x, and the greatest of three as that of two and one."""
        self.generic_visit(node)
        match node:
            case ast.Call(ast.Name("float" | "bool"), [value], []):
                return value
            case ast.Call(ast.Name("min" | "max") as name, [*most, last], []) if len(most) > 1:
                return self.visit_Call(_at(node, ast.Call(name, [ast.Call(name, most, []), last], [])))
        return node

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        """Return `mpc.codegen.jit.assign` as the assignment that it stands for."""
        match node.value:
            case ast.Call(ast.Name("assign"), [target, source], []):
                return _at(node, ast.Assign([ast.Subscript(target, ast.Slice(), ast.Store())], source))
        return self.generic_visit(node)

    def visit_Assign(self, node: ast.Assign) -> list[ast.Assign]:
        """Return one assignment for each target, and a choice for each element of a chosen tuple."""
        self.generic_visit(node)
        *others, first = node.targets
        match first, node.value:
            case ast.Tuple(), ast.IfExp(test, ast.Tuple(yes), ast.Tuple(no)):
                choices: list[ast.expr] = [ast.IfExp(test, a, b) for a, b in zip(yes, no, strict=True)]
                node.value = _at(node, ast.Tuple(choices))
        made = [_at(node, ast.Assign([first], node.value))]
        for target in reversed(others):  # from right to left, as each then has the value before
            value = ast.parse(ast.unparse(made[-1].targets[0]), mode="eval").body
            made.append(_at(node, ast.Assign([target], value)))
        return made


def _at(node: ast.AST, made: N) -> N:
    return ast.fix_missing_locations(ast.copy_location(made, node))


def simplified(node: ast.FunctionDef) -> ast.FunctionDef:
    """Return the function in simpler terms."""
    made: ast.FunctionDef = _Simple().visit(node)
    return made
