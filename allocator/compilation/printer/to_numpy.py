"""Printing of functions of numbers as functions of arrays: `where` chooses between all branches."""

import ast
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from allocator.compilation.printer.python_text import (
    Source,
    asks_for_none,
    assignments,
    names_in,
    refuse,
    statements,
)


def array_form(source: Source, entry: str) -> str:
    """Return the Python text of `entry` and its callees for arrays in place of numbers."""
    return ast.unparse(_array_module(source, entry))


def array_functions(source: Source, *entries: str) -> list[Callable[..., Any]]:
    """Return `entries` for arrays, under their own names; branches not taken may cause NumPy warnings."""
    import numpy as np

    space: dict[str, Any] = {**source.names, "np": np, "abs": np.abs, "sqrt": np.sqrt}
    exec(compile(_array_module(source, *entries), f"<{entries} for arrays>", "exec"), space)
    return [space[entry] for entry in entries]


def _array_module(source: Source, *entries: str) -> ast.Module:
    names = dict.fromkeys(name for entry in entries for name in source.reached(entry))
    again = Source.parsed(source.text, source.names)  # parsed again, as the nodes are changed; copying takes longer
    made = [_array_function(again.functions[name]) for name in names]
    return ast.fix_missing_locations(ast.Module([*made], []))


def _array_function(function: ast.FunctionDef) -> ast.FunctionDef:
    known = {argument.arg for argument in function.args.args}
    body = _array_block(statements(function), known)
    return ast.FunctionDef(function.name, function.args, body, [], None)


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
                assignments(statement)
                known |= {name for target in statement.targets for name in names_in(target)}
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
    """Transformer of expressions of numbers into expressions of arrays."""

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        """Choose elementwise, but test for None once."""
        if asks_for_none(node.test):
            return ast.IfExp(node.test, self.visit(node.body), self.visit(node.orelse))
        test, yes, no = (self.visit(part) for part in (node.test, node.body, node.orelse))
        match yes, no:
            case ast.Tuple(one), ast.Tuple(other) if len(one) == len(other):
                return ast.Tuple([_where(test, a, b) for a, b in zip(one, other, strict=True)], ast.Load())
        return _where(test, yes, no)

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

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        """Compare elementwise, each link of a chain separately."""
        operands = [self.visit(operand) for operand in (node.left, *node.comparators)]
        links = [ast.Compare(a, [op], [b]) for a, op, b in zip(operands, node.ops, operands[1:], strict=False)]
        first: ast.expr = links[0]
        for link in links[1:]:
            first = _numpy("logical_and", [first, link])
        return first
