"""Options that several commands share are declared once, as the fields of a dataclass."""

from collections import Counter
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from inspect import Parameter, signature
from math import isfinite
from typing import Any

from typer.core import TyperCommand

from allocator.errors import InvalidInput


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Let `command` take the fields of a dataclass among its parameters as options of its own.

    A parameter annotated with a dataclass is replaced by the dataclass' fields, which are annotated as typer wants it.
    """
    given = signature(command)
    groups: dict[str, Any] = {name: p.annotation for name, p in given.parameters.items() if is_dataclass(p.annotation)}

    @wraps(command)
    def flat(**values: Any) -> None:
        made = {name: kind(**{f.name: values.pop(f.name) for f in fields(kind)}) for name, kind in groups.items()}
        command(**values, **made)

    own = [p.replace(kind=Parameter.KEYWORD_ONLY) for name, p in given.parameters.items() if name not in groups]
    shared = [
        Parameter(
            f.name,
            Parameter.KEYWORD_ONLY,
            default=Parameter.empty if f.default is MISSING else f.default,
            annotation=f.type,
        )
        for kind in groups.values()
        for f in fields(kind)
    ]
    flat.__signature__ = given.replace(parameters=own + shared)  # type: ignore[attr-defined]
    flat.__annotations__ = {p.name: p.annotation for p in own + shared}
    return flat


class Command(TyperCommand):
    """The command refuses an option given twice, of which the first would be ignored silently."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse as usual. Raises `InvalidInput` for an option given twice."""
        *_, order = self.make_parser(ctx).parse_args(args=list(args))
        for option, times in Counter(order).items():
            if times > 1 and not option.multiple and option.param_type_name == "option":
                raise InvalidInput(f"{option.opts[0]} is given {times} times")
        return super().parse_args(ctx, args)


def within(option: str, value: float | None, unit: str, low: float, high: float) -> None:
    """Insist that a number lies between `low` and `high`, beyond which it is a mistake; None was not given."""
    if value is not None and not low <= value <= high:
        raise InvalidInput(f"{option} {value:g}: expected {low:g} to {high:g} {unit}".rstrip())


def finite(option: str, value: float | None, unit: str) -> None:
    """Insist that a number is finite; None was not given."""
    if value is not None and not isfinite(value):
        raise InvalidInput(f"{option} {value:g}: expected a finite number [{unit}]")


def numbers(option: str, text: str, fewest: int, most: int, example: str) -> list[float]:
    """Read the `fewest` to `most` finite numbers of NUMBER, LOW:HIGH or LOW:HIGH:STEP."""
    try:
        found = [float(part) for part in text.split(":")]
    except ValueError:
        found = []
    if not fewest <= len(found) <= most:
        forms = " or ".join(("NUMBER", "LOW:HIGH", "LOW:HIGH:STEP")[fewest - 1 : most])
        raise InvalidInput(f"{option} {text}: expected {forms}, such as {example}")
    return found
