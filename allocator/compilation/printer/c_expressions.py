"""Printing of expressions as C."""

import ast

from allocator.compilation.printer.c_declarations import MADE, Text, Unit, arguments_of, literal
from allocator.compilation.printer.c_layout import (
    AND,
    ATOM,
    CHOICE,
    FLAGS,
    INT,
    LINK,
    LINKS,
    OR,
    REAL,
    SIGNS,
    SUM,
    UNARY,
    compared,
)  # fmt: skip
from allocator.compilation.printer.python_text import asks_for_none, refuse


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
