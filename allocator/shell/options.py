"""Options that several commands share are declared once, as the fields of a dataclass."""

from collections import Counter
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from inspect import Parameter, get_annotations, signature
from math import isfinite
from typing import Annotated, Any, get_args

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
            annotation=_in_panel(kind, f),
        )
        for kind in groups.values()
        for f in fields(kind)
    ]
    flat.__signature__ = given.replace(parameters=own + shared)  # type: ignore[attr-defined]
    flat.__annotations__ = {p.name: p.annotation for p in own + shared}
    return flat


def _in_panel(kind: Any, field: Any) -> Any:
    """Return the annotation of a field, with the panel of the class that declares it."""
    panel = next(c.PANEL for c in kind.__mro__ if field.name in get_annotations(c))
    what, option = get_args(field.type)
    option = copy(option)
    option.rich_help_panel = panel
    return Annotated[what, option]


class Command(TyperCommand):
    """The command refuses an option given twice, of which the first would be ignored silently."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the help of arguments and options, those of a panel together."""
        panels: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            if (record := parameter.get_help_record(ctx)) is not None:
                usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
                panels.setdefault(getattr(parameter, "rich_help_panel", None) or usual, []).append(record)
        for name, records in panels.items():
            if records:
                with formatter.section(name):
                    formatter.write_dl(records)

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


def row(option: str, text: str, unit: str, counts: Mapping[int, str] | None = None) -> list[float]:
    """Read finite numbers with commas between them, as many as one of `counts` says (what so many are)."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not found or (counts and len(found) not in counts):
        listed = " or ".join(f"{count} ({what})" for count, what in (counts or {}).items())
        raise InvalidInput(f"{option} {text}: expected {listed} numbers with commas between them [{unit}]")
    for value in found:
        finite(option, value, unit)
    return found


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
