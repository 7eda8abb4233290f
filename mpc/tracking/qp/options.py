"""Solvers are values that hold their options: `OSQP(eps_abs=1e-8)`; a name or a dict of options does as well."""

from collections.abc import Mapping
from dataclasses import fields
from functools import cached_property
from typing import Any, ClassVar, Self, TypeVar

from allocator.errors import InvalidInput, MissingBackend


class SolverOptions:
    """The options of a solver are a frozen dataclass, its fields named as the solver names them.

    None leaves the solver its own default. `InvalidInput` for an option that does not exist.
    """

    name: ClassVar[str]

    def __new__(cls, *values: Any, **options: Any) -> Self:
        """Insist on names of options that there are."""
        names = [field.name for field in fields(cls)]  # type: ignore[arg-type]  # members are dataclasses
        if unknown := [name for name in options if name not in names]:
            raise InvalidInput(f"{cls.__name__} has no option {unknown[0]!r}; its options are {', '.join(names)}")
        return super().__new__(cls)

    @cached_property
    def given(self) -> dict[str, Any]:
        """The options that are not left to the solver."""
        pairs = ((field.name, getattr(self, field.name)) for field in fields(self))  # type: ignore[arg-type]
        return {name: value for name, value in pairs if value is not None}


S = TypeVar("S", bound=SolverOptions)


def with_options(kind: str, solver: str | Mapping[str, Any], members: Mapping[str, type[S]], default: str) -> S:
    """Return the member that the name `solver` or a dict of its options, by default those of `default`, stands for.

    In a dict "name" says which solver it is about. `MissingBackend` lists the names there are of this `kind`.
    """
    options = {"name": solver} if isinstance(solver, str) else dict(solver)
    name = options.pop("name", default)
    if name not in members:
        raise MissingBackend(kind, name, members)
    return members[name](**options)


__all__ = ["SolverOptions", "with_options"]
