"""Functions that compiled ones call are compiled once for all values of their arguments."""

from mpc.codegen.jit import compiled, inlined


@inlined
def scaled(x, times, negative=False):
    return -times * x if negative else times * x


@compiled
def combined(x, n):
    return scaled(x, 2) + scaled(x, 3, negative=True) + scaled(x, n) + scaled(x, n, n > 3)


def test_a_constant_is_compiled_as_any_other_number():
    assert combined(2.0, 5) == 2 * 2 - 2 * 3 + 2 * 5 - 2 * 5
    assert combined(2.0, 1) == 2 * 2 - 2 * 3 + 2 * 1 + 2 * 1
    assert len(combined.overloads) == 1
    assert [tuple(map(str, kinds)) for kinds in scaled.overloads if "omitted" not in str(kinds[-1])] == [
        ("float64", "int64", "bool")
    ]
