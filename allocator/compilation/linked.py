"""Compilers of functions that only compiled functions call, and of those that call them.

numba optimises every function together with all functions that it calls and translates the result into machine code,
before it does the same for the caller: the innermost of ten nested functions is optimised ten times, for machine code
that nobody runs. The library of a function compiled here is only linked into those of its callers, where it is
optimised once. The structured QP compiles in two thirds of the time, to code of the same speed.

Their callers are optimised with superword-level parallelism, which numba leaves off: lines that are written out, such
as those of a matrix of six columns, are computed four numbers at a time.
"""

from typing import Any

from numba import config
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class Linked(JITCodeLibrary):  # type: ignore[misc]  # numba has no types
    """Library without machine code."""

    def _optimize_functions(self, ll_module: object) -> None:
        """Simplify functions at a low level, before their callers optimise them."""
        usual, config.OPT = config.OPT, min(config.OPT, 1)
        try:
            super()._optimize_functions(ll_module)
        finally:
            config.OPT = usual

    def _optimize_final_module(self) -> None:
        """Leave that to the callers."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0, numba's address of functions that Python cannot call."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> "_Unset":
        """Return the code generator, without setting an environment in machine code that does not exist."""
        return _Unset(self._codegen)


class Whole(JITCodeLibrary):  # type: ignore[misc]
    """Library of a function with all that it calls."""

    def _optimize_final_module(self) -> None:
        """Optimise with superword-level parallelism."""
        usual, config.SLP_VECTORIZE = config.SLP_VECTORIZE, 1
        try:
            super()._optimize_final_module()
        finally:
            config.SLP_VECTORIZE = usual


class _Unset:
    """A code generator as `get_executable` uses it."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, env_name: str, env: object) -> None:
        """Do nothing."""


class OnlyLinked(Compiler):  # type: ignore[misc]
    """Compiler of functions that only compiled ones call, for numba's `pipeline_class`."""

    kind: type = Linked

    def define_pipelines(self) -> Any:
        """Return numba's own pipelines, which fill a library of this kind."""
        state = self.state
        state.library = self.kind(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().define_pipelines()


class Calling(OnlyLinked):
    """Compiler of functions that Python calls, for numba's `pipeline_class`."""

    kind = Whole


INNER: dict[str, Any] = {  # options of such functions; wrappers are slow to compile, too
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": OnlyLinked,
}
