"""Options of the commands that read measured data, and their progress display."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, TypeVar

import typer
from typer.models import OptionInfo

from allocator.errors import InvalidInput
from allocator.identification.columns import parse_columns
from allocator.lazy import Console
from allocator.presentation.progress import counted

if TYPE_CHECKING:
    from rich.progress import Progress

T = TypeVar("T")


def columns_option(example: str) -> OptionInfo:
    """Return the option --columns with an example of the command's own quantities."""
    option: OptionInfo = typer.Option(
        help=f"quantities of columns with other names, such as {example}; a unit follows the name, :-N reverses the "
        "sign, :bar(abs) subtracts the atmosphere, and ignore=NAME leaves a column out"
    )
    return option


@dataclass(frozen=True)
class LogOptions:
    """Options of measured data in files: the names of columns, lines to leave out, and the topics of a bag."""

    PANEL: ClassVar[str] = "Options"

    columns: Annotated[str | None, columns_option("pressure1=p1:bar,theta=phi:deg")] = None
    skip_rows: Annotated[int, typer.Option(min=0, help="number of lines to leave out at the beginning of the file")] = 0
    topics: Annotated[
        str | None,
        typer.Option(
            help="quantities and their fields in a ROS bag or an MCAP file; such as "
            "'theta=/joint_states.position[0] pressure1=/valves.data[0]:bar', in SI units unless a unit "
            "follows. Each message of the first topic gives a row"
        ),
    ] = None

    def read(self, reader: Callable[..., T], *source: object) -> T:
        """Return what `reader`, such as `read_motion_log`, reads from a `source`."""
        return reader(*source, columns=parse_columns(self.columns), skip_rows=self.skip_rows, topics=self.topics)


def assigned(option: str, settings: Sequence[str], expected: str) -> dict[str, float]:
    """Return the numbers in NAME=NUMBER by name; `expected` describes valid settings in an error."""
    numbers: dict[str, float] = {}
    for setting in settings:
        name, _, value = (part.strip() for part in setting.partition("="))
        if name in numbers:
            raise InvalidInput(f"{option} {setting}: {name} is given twice")
        try:
            numbers[name] = float(value)
        except ValueError:
            raise InvalidInput(f"{option} {setting}: expected {expected}") from None
    return numbers


def each(models: Iterable[T]) -> Iterable[T]:
    """Return the models to iterate over; the progress of several is shown."""
    models = tuple(models)
    return counted(models, "fitting") if len(models) > 1 else models


def clock(console: "Console") -> "Progress":
    """Return a line with the elapsed time, for work of unknown length."""
    from rich.progress import Progress, TimeElapsedColumn

    return Progress(*Progress.get_default_columns()[:2], TimeElapsedColumn(), console=console, transient=True)


def print_lines(console: "Console", lines: Iterable[str]) -> None:
    """Print lines as they are, without colours."""
    for line in lines:
        console.print(line, markup=False, highlight=False)
