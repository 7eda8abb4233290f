"""Operators and number types of C."""

import ast

REAL, INT = "ant_real", "int"
LINKS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
SIGNS = {ast.Add: ("+", 12), ast.Sub: ("-", 12), ast.Mult: ("*", 13), ast.Div: ("/", 13), ast.BitOr: ("|", 6)}
CHOICE, OR, AND, FLAGS, LINK, SUM, UNARY, ATOM = 3, 4, 5, 6, 10, 12, 14, 16  # how strongly they bind; ATOM: no operator
