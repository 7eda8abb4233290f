"""Options of solvers, as values such as `OSQP(eps_abs=1e-8)`, names or dicts."""

from collections.abc import Mapping
from dataclasses import fields
from functools import cached_property
from math import inf
from numbers import Integral, Real
from types import UnionType
from typing import Any, ClassVar, Self, TypeVar, get_args

import numpy as np

from allocator.errors import InvalidInput, MissingBackend

_MOST = 2**31 - 1  # greatest C int


class SolverOptions:
    """Options of a solver: a frozen dataclass with the solver's own names of fields.

    None selects the solver's own default. Raises `InvalidInput` for unknown options and invalid values.
    """

    name: ClassVar[str]

    def __new__(cls, *values: object, **options: object) -> Self:
        """Raise `InvalidInput` for unknown options."""
        names = [field.name for field in fields(cls)]  # type: ignore[arg-type]  # members are dataclasses
        if unknown := [name for name in options if name not in names]:
            raise InvalidInput(f"{cls.__name__} has no option {unknown[0]!r}; its options are {', '.join(names)}")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        """Raise `InvalidInput` for values that do not have the declared kind."""
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            kinds = get_args(field.type) if isinstance(field.type, UnionType) else (field.type,)
            wanted = next((says for kind, says, holds in _KINDS if kind in kinds and not holds(value)), None)
            if wanted and not (value is None and type(None) in kinds):
                raise InvalidInput(f"{type(self).__name__}: {field.name} = {value!r} has to be {wanted}")

    @cached_property
    def given(self) -> dict[str, object]:
        """Options set by the caller."""
        pairs = ((field.name, getattr(self, field.name)) for field in fields(self))  # type: ignore[arg-type]
        return {name: value for name, value in pairs if value is not None}


def _is_number(value: object) -> bool:
    return not isinstance(value, bool) and isinstance(value, Real) and 0 <= float(value) < inf


def _is_count(value: object) -> bool:
    return not isinstance(value, bool) and isinstance(value, Integral) and 0 <= int(value) <= _MOST


_KINDS = (  # kind of a field, description of its values
    (float, "a number of at least 0", _is_number),
    (int, "a whole number of at least 0", _is_count),
    (bool, "True or False", lambda value: isinstance(value, bool | np.bool_)),
    (str, "a name", lambda value: isinstance(value, str)),
)

S = TypeVar("S", bound=SolverOptions)


def with_options(kind: str, solver: str | Mapping[str, Any], members: Mapping[str, type[S]], default: str) -> S:
    """Return the member for the name `solver` or for a dict of options.

    In a dict, "name" selects the solver, by default `default`. `MissingBackend` lists the valid names of this `kind`.
    """
    options = {"name": solver} if isinstance(solver, str) else dict(solver)
    if odd := [key for key in options if not isinstance(key, str)]:
        raise InvalidInput(f"solver = {solver!r}: {odd[0]!r} is no name of an option")
    name = options.pop("name", default)
    if name not in members:
        raise MissingBackend(kind, name, members)
    return members[name](**options)
