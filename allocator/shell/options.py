"""Options shared by several commands, as fields of dataclasses, and the help of a command."""

import re
from collections import Counter
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from inspect import Parameter, cleandoc, get_annotations, signature
from math import isfinite
from textwrap import wrap
from typing import Annotated, Any, Final, get_args

from typer.core import TyperCommand

from allocator.errors import InvalidInput
from allocator.units import DEG

ALL: Final = "--help-all"
_NAMES_WIDTH = 60
_LIST = re.compile(r"<list\[(\w+)\]>")  # the type of an option that may be repeated


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Let `command` take the fields of a dataclass among its parameters as options of its own.

    A parameter annotated with a dataclass is replaced by the fields of that dataclass, in its place.
    """
    given = signature(command)
    groups: dict[str, Any] = {name: p.annotation for name, p in given.parameters.items() if is_dataclass(p.annotation)}

    @wraps(command)
    def flat(**values: Any) -> None:
        made = {name: kind(**{f.name: values.pop(f.name) for f in fields(kind)}) for name, kind in groups.items()}
        command(**values, **made)

    options = [
        option
        for name, p in given.parameters.items()
        for option in (_options(groups[name]) if name in groups else [p.replace(kind=Parameter.KEYWORD_ONLY)])
    ]
    flat.__signature__ = given.replace(parameters=options)  # type: ignore[attr-defined]
    flat.__annotations__ = {p.name: p.annotation for p in options}
    return flat


def _options(kind: Any) -> list[Parameter]:
    """Return the options that the fields of a dataclass declare."""
    return [
        Parameter(
            f.name,
            Parameter.KEYWORD_ONLY,
            default=Parameter.empty if f.default is MISSING else f.default,
            annotation=_in_panel(kind, f),
        )
        for f in fields(kind)
    ]


def _in_panel(kind: Any, field: Any) -> Any:
    """Return the annotation of a field, with its own panel or that of the class that declares it."""
    panel = next(c.PANEL for c in kind.__mro__ if field.name in get_annotations(c))
    what, option = get_args(field.type)
    option = copy(option)
    option.rich_help_panel = option.rich_help_panel or panel
    return Annotated[what, option]


class Command(TyperCommand):
    """A command whose --help fits on a screen: each option in a line or two, and shared options by name.

    --help-all shows everything: the whole description, the text of each option after its first semicolon, and the
    options of every panel.
    """

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.context_settings = {**self.context_settings, "help_option_names": ["--help", ALL]}

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help: everything if --help-all is given, else the first paragraph and the short texts."""
        whole = ctx.meta.get(ALL, False)
        self.format_usage(ctx, formatter)
        text = cleandoc(self.help or "")
        _paragraphs(formatter, text if whole else text.partition("\n\n")[0])
        self._write_options(ctx, formatter, whole)
        if whole:
            self.format_epilog(ctx, formatter)

    def _write_options(self, ctx: Any, formatter: Any, whole: bool) -> None:
        """Write arguments and options, those of a panel together."""
        panels: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        shared: dict[str, list[str]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None or ALL in record[0]:
                continue
            panel = getattr(parameter, "rich_help_panel", None)
            usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
            name = _LIST.sub(r"<\1>", record[0])
            if panel and panel != usual and not whole:
                shared.setdefault(panel, []).append(parameter.opts[0])
            else:
                panels.setdefault(panel or usual, []).append((name, record[1] if whole else _short(record[1])))
        panels["Options"].append((ALL, "describe every option, with examples" if not whole else "this text"))
        for name, records in panels.items():
            if records:
                with formatter.section(name):
                    formatter.write_dl(records)
        if shared:
            with formatter.section(f"Further options, described by {ALL}"):
                formatter.write_dl([row for panel, names in shared.items() for row in _listed(panel, names)])

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse as usual. Raises `InvalidInput` for an option given twice."""
        ctx.meta[ALL] = ALL in args
        *_, order = self.make_parser(ctx).parse_args(args=list(args))
        for option, times in Counter(order).items():
            if times > 1 and not option.multiple and option.param_type_name == "option":
                raise InvalidInput(f"{option.opts[0]} is given {times} times")
        return super().parse_args(ctx, args)


def _short(text: str) -> str:
    """Return the help of an option up to its first semicolon, with its default."""
    text, _, extra = text.partition("  [")
    text = text.partition(";")[0]
    return f"{text}  [{extra}" if extra else text


def _listed(panel: str, names: list[str]) -> list[tuple[str, str]]:
    """Return rows of a panel's options, whose names stay in one piece."""
    lines = wrap(", ".join(names), _NAMES_WIDTH, break_on_hyphens=False)
    return [(panel if i == 0 else "", line) for i, line in enumerate(lines)]


def _paragraphs(formatter: Any, text: str) -> None:
    """Write a description, indented."""
    formatter.write_paragraph()
    with formatter.indentation():
        formatter.write_text(text)


def within(option: str, value: float | None, unit: str, low: float, high: float) -> None:
    """Insist that a number lies between `low` and `high`, beyond which it is a mistake; None was not given."""
    if value is not None and not low <= value <= high:
        raise InvalidInput(f"{option} {value:g}: expected {low:g} to {high:g} {unit}".rstrip())


def finite(option: str, value: float | None, unit: str) -> None:
    """Insist that a number is finite; None was not given."""
    if value is not None and not isfinite(value):
        raise InvalidInput(f"{option} {value:g}: expected a finite number [{unit}]")


def row(option: str, text: str, unit: str, counts: Mapping[int, str] | None = None) -> list[float]:
    """Read finite numbers separated by commas; `counts` maps permitted counts to their meanings."""
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


def read_gravity(text: str, otherwise: str = "") -> tuple[float, ...]:
    """Read --gravity: m g l of a link [N·m] and, if it is given, the angle at which the link hangs, in rad."""
    torque, *hanging = row("--gravity", text, f"N·m and degrees{otherwise}", {1: "G", 2: "G,θh"})
    within("--gravity", torque, "N·m", -1e6, 1e6)
    return torque, *(angle * DEG for angle in hanging)


def numbers(option: str, text: str, fewest: int, most: int, example: str) -> list[float]:
    """Read the `fewest` to `most` finite numbers of NUMBER, LOW:HIGH or LOW:HIGH:STEP."""
    try:
        found = [float(part) for part in text.split(":")]
    except ValueError:
        found = []
    if not fewest <= len(found) <= most:
        forms = " or ".join(("NUMBER", "LOW:HIGH", "LOW:HIGH:STEP")[fewest - 1 : most])
        forms = forms or f"{fewest} numbers with colons between them"
        raise InvalidInput(f"{option} {text}: expected {forms}, such as {example}")
    return found
