"""Decorators for numba: IEEE arithmetic, division by zero included, with fused products and sums."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from numba import config, njit, types
from numba.extending import lower_builtin, type_callable

from allocator.calculus import Array
from allocator.compilation.cache import keep
from allocator.compilation.linked import INNER, Calling


def pick(test: bool, a: float, b: float) -> float:
    """Return `a` if `test` else `b`.

    `mpc.codegen.jit` compiles it without a branch. Formulas have many choices, and a compiler walks all branches: a
    plant of 170 choices compiles in half the time.
    """
    return a if test else b


if config.DISABLE_JIT:
    raise ImportError("compilation is switched off by NUMBA_DISABLE_JIT")

KEPT = "antagonist_"  # prefix of modules with cached code; a hash of all their sources follows
F = TypeVar("F", bound=Callable[..., object])
_OPTIONS: dict[str, object] = {"error_model": "numpy", "fastmath": {"contract"}}

_OUTER: dict[str, object] = {"pipeline_class": Calling, **_OPTIONS}
_COUNTED: dict[str, object] = {"_nrt": True}  # references are counted
_FLAT: dict[str, object] = {"_nrt": False}


def _of_types(dispatcher: F) -> F:
    """Return the `dispatcher`, which compiled callers let compile once for all values of its arguments.

    numba would compile a function that is called with a constant for that number alone, besides for all others.
    """
    made: Any = dispatcher
    template = made.get_call_template

    def of_types(args: Iterable[object], kws: Mapping[str, object]) -> object:
        """Return numba's template of a call, with types in the place of constants."""
        return template(
            tuple(map(types.unliteral, args)), {name: types.unliteral(kind) for name, kind in dict(kws).items()}
        )

    made.get_call_template = of_types
    return dispatcher


def compiled(function: F) -> F:
    """Compile `function` when it is first called.

    numba notices changes in the file of a function, but not in the files of functions that it calls. Results are
    therefore cached on disk only for modules that `mpc.codegen.modules` names. Raises an `OSError` if the cache cannot
    be written.
    """
    made: F = _of_types(njit(**_OUTER)(function))
    return keep(made) if function.__module__.startswith(KEPT) else made


def exactly(function: F) -> F:
    """Compile `function` as `compiled` does, without fusing operations: the results equal Python's bit by bit."""
    made: F = _of_types(njit(error_model="numpy")(function))
    return keep(made) if function.__module__.startswith(KEPT) else made


def inlined(function: F) -> F:
    """Compile `function` as a part of the compiled functions that call it; Python cannot call it."""
    made: F = _of_types(njit(**_COUNTED, **INNER, **_OPTIONS)(function))
    return made


def compiled_flat(function: F) -> F:
    """Compile a `function` that neither makes nor returns arrays as `compiled` does.

    References to arrays are then not counted, which saves a quarter of the time to compile.
    """
    made: F = _of_types(njit(**_FLAT, **_OUTER)(function))
    return keep(made) if function.__module__.startswith(KEPT) else made


def inlined_flat(function: F) -> F:
    """Compile a `function` that neither makes nor returns arrays as `inlined` does."""
    made: F = _of_types(njit(**_FLAT, **INNER, **_OPTIONS)(function))
    return made


def merged(function: F) -> F:
    """Compile `function` of numbers into its only caller, so that no tuple of results passes through memory."""
    made: F = _of_types(njit(forceinline=True, **_FLAT, **INNER, **_OPTIONS)(function))
    return made


@type_callable(pick)  # type: ignore[untyped-decorator]
def _typed(context: object) -> Callable[..., object]:
    return lambda test, a, b: types.float64


@lower_builtin(pick, types.boolean, types.float64, types.float64)  # type: ignore[untyped-decorator]
def _selected(context: object, builder: Any, signature: object, values: tuple[object, ...]) -> object:
    return builder.select(*values)


@inlined
def assign(target: Array, source: Array) -> None:
    """Copy `source` into `target`, of the same shape.

    With `target[:] = source` numba spends three seconds compiling the error message for different shapes.
    """
    for i in range(target.size):
        target.flat[i] = source.flat[i]
