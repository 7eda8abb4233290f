"""The two tables of CasADi's operations are kept here: in Python for numba, and in C99 for either precision.

Both hold every operation of numbers that a CasADi SX function can have, but three: OP_ERFINV, which neither numba nor
math.h knows, OP_PRINTME, which prints, and OP_CALL, a function that was told not to be inlined. Truth is a number, 1 or
0. `ANT_F` is the export's macro for a function of math.h in the precision chosen.
"""

from mpc.codegen.graphs import Language

_BOTH = {
    "OP_ASSIGN": "{0}",
    "OP_ADD": "{0} + {1}",
    "OP_SUB": "{0} - {1}",
    "OP_MUL": "{0} * {1}",
    "OP_DIV": "{0} / {1}",
    "OP_NEG": "-{0}",
    "OP_SQ": "{0} * {0}",
}
_MATH = (
    "exp", "expm1", "log", "log1p", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
    "asinh", "acosh", "atanh", "erf",
)  # fmt: skip
_MATH_OF_TWO = ("atan2", "hypot", "copysign")
_C_ONLY = ("fabs", "floor", "ceil")
_C_ONLY_OF_TWO = ("pow", "fmod", "remainder", "fmin", "fmax")

_R = "np.fmod({0}, {1})"  # what the multiple of {1} next towards 0 leaves of {0}
_REMAINDER = (  # what the nearest one leaves, of two the even one
    f"{_R} if abs({_R}) < abs({{1}}) - abs({_R}) else {_R} - math.copysign({{1}}, {{0}}) "
    f"if abs({_R}) > abs({{1}}) - abs({_R}) else {_R} - 2.0 * np.fmod(0.5 * ({{0}} - {_R}), {{1}})"
)

PYTHON = Language(
    "Python",
    {
        **_BOTH,
        "OP_TWICE": "2.0 * {0}",
        "OP_INV": "1.0 / {0}",
        "OP_POW": "{0} ** {1}",
        "OP_CONSTPOW": "{0} ** {1}",
        **{f"OP_{name.upper()}": f"math.{name}({{0}})" for name in _MATH},
        **{f"OP_{name.upper()}": f"math.{name}({{0}}, {{1}})" for name in _MATH_OF_TWO},
        "OP_FMOD": "np.fmod({0}, {1})",
        "OP_REMAINDER": _REMAINDER,  # numba has none
        "OP_FABS": "abs({0})",
        "OP_FLOOR": "np.floor({0})",  # that of `math` is an integer, which infinity is not
        "OP_CEIL": "np.ceil({0})",
        "OP_SIGN": "1.0 if {0} > 0.0 else -1.0 if {0} < 0.0 else {0}",
        "OP_LT": "1.0 if {0} < {1} else 0.0",
        "OP_LE": "1.0 if {0} <= {1} else 0.0",
        "OP_EQ": "1.0 if {0} == {1} else 0.0",
        "OP_NE": "1.0 if {0} != {1} else 0.0",
        "OP_NOT": "1.0 if {0} == 0.0 else 0.0",
        "OP_AND": "1.0 if {0} != 0.0 and {1} != 0.0 else 0.0",
        "OP_OR": "1.0 if {0} != 0.0 or {1} != 0.0 else 0.0",
        "OP_FMIN": "{0} if {0} < {1} or {1} != {1} else {1}",  # of a number and NaN the number, as in C
        "OP_FMAX": "{0} if {0} > {1} or {1} != {1} else {1}",
        "OP_IF_ELSE_ZERO": "{1} if {0} != 0.0 else 0.0",
    },
    temporary="v{}",
)

C = Language(
    "C",
    {
        **_BOTH,
        "OP_TWICE": "{0} + {0}",
        "OP_INV": "1 / {0}",
        "OP_CONSTPOW": "ANT_F(pow)({0}, {1})",
        **{f"OP_{name.upper()}": f"ANT_F({name})({{0}})" for name in (*_MATH, *_C_ONLY)},
        **{f"OP_{name.upper()}": f"ANT_F({name})({{0}}, {{1}})" for name in (*_MATH_OF_TWO, *_C_ONLY_OF_TWO)},
        "OP_SIGN": "{0} > 0 ? 1 : {0} < 0 ? -1 : {0}",
        "OP_LT": "{0} < {1}",
        "OP_LE": "{0} <= {1}",
        "OP_EQ": "{0} == {1}",
        "OP_NE": "{0} != {1}",
        "OP_NOT": "{0} == 0",
        "OP_AND": "{0} != 0 && {1} != 0",
        "OP_OR": "{0} != 0 || {1} != 0",
        "OP_IF_ELSE_ZERO": "{0} != 0 ? {1} : 0",
    },
    temporary="t{}",
)
