"""Printing of functions of numbers as functions of arrays: `where` chooses between all branches."""

import ast
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import Any

from allocator.compilation.jit import Function
from allocator.compilation.printer.python_text import asks_for_none, refuse, statements, tree, with_called

_KNOWN = (
    *(ast.Assign, ast.If, ast.For, ast.Return, ast.Name, ast.Constant, ast.Tuple, ast.IfExp, ast.Call),
    *(ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.BitOr, ast.UnaryOp, ast.USub, ast.Not),
    *(ast.BoolOp, ast.And, ast.Or, ast.Compare, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq, ast.Is),
    *(ast.Load, ast.Store),
)


def array_functions(*entries: Function) -> list[Callable[..., Any]]:
    """Return functions for arrays in place of numbers; branches not taken may cause NumPy warnings.

    Raises `Unprintable` for constructs without an equivalent.
    """
    import numpy as np

    own = cache(tree)  # trees that may be changed
    functions = with_called(entries, own)
    space = {name: value for function in functions for name, value in function.__globals__.items()}
    space |= {"np": np, "abs": np.abs, "sqrt": np.sqrt}
    module = ast.fix_missing_locations(ast.Module([_array_function(own(function)) for function in functions], []))
    exec(compile(module, f"<{', '.join(entry.__name__ for entry in entries)} for arrays>", "exec"), space)
    return [space[entry.__name__] for entry in entries]


def _array_function(function: ast.FunctionDef) -> ast.FunctionDef:
    known = {argument.arg for argument in function.args.args}
    _check(function)
    return ast.FunctionDef(function.name, function.args, _array_block(statements(function), known), [], None)


def _check(function: ast.FunctionDef) -> None:
    """Raise `Unprintable` for constructs that do not apply to arrays element by element."""
    nodes = [inner for statement in statements(function) for inner in ast.walk(statement)]
    if strange := next((node for node in nodes if not isinstance(node, _KNOWN)), None):
        refuse(next(node for node in reversed(nodes) if strange in ast.walk(node) and hasattr(node, "lineno")))
    for node in nodes:
        if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.Is) and not asks_for_none(node):
            refuse(node)
        if isinstance(node, ast.Call) and (not isinstance(node.func, ast.Name) or node.keywords):
            refuse(node)


def _array_block(block: list[ast.stmt], known: set[str]) -> list[ast.stmt]:
    done: list[ast.stmt] = []
    for i, statement in enumerate(block):
        name = f"_test{statement.lineno}_{statement.col_offset}"
        match statement:
            case ast.If(test, [ast.Return(ast.expr() as early)], []) if not asks_for_none(test):
                rest = _array_block(block[i + 1 :], known)
                if not rest or not isinstance(last := rest[-1], ast.Return) or last.value is None:
                    refuse(statement, "nothing is returned otherwise")
                done += [_stored(name, _Arrays().visit(test)), _stored(f"{name}_so", _Arrays().visit(early))]
                return [*done, *rest[:-1], ast.Return(_where(name, _load(f"{name}_so"), last.value))]
            case ast.If(test, body, orelse) if not asks_for_none(test):
                done.append(_stored(name, _Arrays().visit(test)))
                done += _chosen(name, body, orelse, known)
            case ast.If(test, body, orelse):
                done.append(ast.If(test, _array_block(body, known), _array_block(orelse, known)))
            case ast.For(target, ast.Call(ast.Name("range"), [_]) as count, body, []):
                done.append(ast.For(target, count, _array_block(body, known), []))
            case ast.Assign():
                _assigned(statement)
                known |= _names(statement.targets[0])
                done.append(_Arrays().visit(statement))
            case ast.Return(ast.expr()):
                done.append(_Arrays().visit(statement))
            case _:
                refuse(statement)
    return done


def _chosen(test: str, body: list[ast.stmt], orelse: list[ast.stmt], known: set[str]) -> Iterator[ast.stmt]:
    """Yield the assignments of both branches of `test`, each conditional on it."""
    for statement, holds in (*((s, True) for s in body), *((s, False) for s in orelse)):
        if not isinstance(statement, ast.Assign):
            refuse(statement, "in a branch")
        for target, value in _assigned(statement):
            if not isinstance(target, ast.Name) or target.id not in known:
                refuse(statement, "first assigned in a branch")
            new, old = _Arrays().visit(value), _load(target.id)
            yield _stored(target.id, _where(test, new, old) if holds else _where(test, old, new))


def _assigned(statement: ast.Assign) -> list[tuple[ast.expr, ast.expr]]:
    """Return the (target, value) pairs of `statement`, one per element if a tuple is assigned to a tuple.

    They are assigned in order: no value may read a name assigned just before.
    """
    match statement.targets[0], statement.value:
        case ast.Tuple(targets), ast.Tuple(values) if len(targets) == len(values):
            found = list(zip(targets, values, strict=True))
        case target, value:
            found = [(target, value)]
    new: set[str] = set()
    for target, value in found:
        if new & _names(value):
            refuse(statement, "a value asks for a name that has just been assigned")
        new |= _names(target)
    return found


def _names(node: ast.AST) -> set[str]:
    """Return all names in `node`."""
    return {inner.id for inner in ast.walk(node) if isinstance(inner, ast.Name) and inner.id != "_"}


def _load(name: str) -> ast.expr:
    return ast.Name(name, ast.Load())


def _stored(name: str, value: ast.expr) -> ast.stmt:
    return ast.Assign([ast.Name(name, ast.Store())], value)


def _where(test: str | ast.expr, yes: ast.expr, no: ast.expr) -> ast.expr:
    return _numpy("where", [_load(test) if isinstance(test, str) else test, yes, no])


def _numpy(function: str, arguments: Iterable[ast.expr]) -> ast.expr:
    return ast.Call(ast.Attribute(_load("np"), function, ast.Load()), list(arguments), [])


class _Arrays(ast.NodeTransformer):
    """Transformer of expressions of numbers into expressions of arrays."""

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        """Choose elementwise, but test for None once."""
        if asks_for_none(node.test):
            return ast.IfExp(node.test, self.visit(node.body), self.visit(node.orelse))
        return _where(*(self.visit(part) for part in (node.test, node.body, node.orelse)))

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        """Combine truth values elementwise."""
        first, *others = map(self.visit, node.values)
        for other in others:
            first = _numpy("logical_and" if isinstance(node.op, ast.And) else "logical_or", [first, other])
        return first  # type: ignore[no-any-return]  # visit is untyped

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        """Negate truth values elementwise."""
        operand = self.visit(node.operand)
        return _numpy("logical_not", [operand]) if isinstance(node.op, ast.Not) else ast.UnaryOp(node.op, operand)
