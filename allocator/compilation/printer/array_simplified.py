"""Python without a counterpart in C, rewritten in terms that have one."""

import ast
from typing import TypeVar

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
