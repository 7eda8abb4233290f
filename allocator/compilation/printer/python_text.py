"""Trees of the functions to be printed, in simpler terms: Python without a counterpart in C is rewritten."""

import ast
import inspect
import io
import textwrap
import tokenize
from collections.abc import Callable, Sequence
from functools import cache
from inspect import isbuiltin
from typing import NoReturn, TypeVar

from allocator.compilation.jit import Function
from allocator.errors import AntagonistError


class Unprintable(AntagonistError):
    """Unsupported construct; the message shows it and gives its line."""


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
                node.value = _at(node, ast.Tuple(choices, ast.Load()))
        made = [_at(node, ast.Assign([first], node.value))]
        for target in reversed(others):  # from right to left, as each then has the value before
            value = ast.parse(ast.unparse(made[-1].targets[0]), mode="eval").body
            made.append(_at(node, ast.Assign([target], value)))
        return made


def _at(node: ast.AST, made: N) -> N:
    return ast.fix_missing_locations(ast.copy_location(made, node))


def with_called(
    functions: Sequence[Function], tree_of: Callable[[Function], ast.FunctionDef] | None = None
) -> list[Function]:
    """Return `functions` and all that they call, directly or not, looked up in their globals."""
    tree_of = tree_of or parsed
    found: dict[str, Function] = {}
    left = [*functions]
    while left:
        function = left.pop(0)
        node, names = tree_of(function), getattr(function, "py_func", function).__globals__
        if node.name in found:
            continue
        found[node.name] = function
        called = [n.func.id for n in ast.walk(node) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)]
        left += [names[name] for name in dict.fromkeys(called) if not isbuiltin(names.get(name, abs))]
    return [*found.values()]


def parsed(function: Function) -> ast.FunctionDef:
    """Return the tree of a function, or of the function that a numba dispatcher compiles, in simpler terms."""
    return _kept(getattr(function, "py_func", function))


@cache
def _kept(function: Function) -> ast.FunctionDef:
    return tree(function)


def tree(function: Function) -> ast.FunctionDef:
    """Return a new tree of a function, in simpler terms. Raises `Unprintable`."""
    [node] = ast.parse(_text(function)).body
    if not isinstance(node, ast.FunctionDef):
        raise Unprintable(f"{function} is no function")
    made: ast.FunctionDef = _Simple().visit(node)
    return made


@cache
def _text(function: Function) -> str:
    return textwrap.dedent(inspect.getsource(function))


def comments(function: Function) -> dict[int, str]:
    """Return the comments of a function by line, without those for linters."""
    text = io.StringIO(_text(getattr(function, "py_func", function)))
    tokens = tokenize.generate_tokens(text.readline)
    said = {t.start[0]: t.string.lstrip("# ") for t in tokens if t.type == tokenize.COMMENT}
    return {line: text for line, text in said.items() if not text.startswith(("noqa", "type: ", "fmt: "))}
