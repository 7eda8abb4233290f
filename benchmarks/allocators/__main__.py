"""Run the comparison: `python -m benchmarks.allocators --help`."""

import argparse
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.allocators import figures, report
from benchmarks.allocators.comparison import Results, compare
from benchmarks.allocators.summary import EXPLAINED, HEADER, summary
from benchmarks.allocators.truth import BenchmarkFailure

LEAST_WIDTH = 100  # [characters] of the main table
RESULTS = Path(__file__).parents[1] / "results"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.allocators", description=__doc__.partition(":")[0])
    parser.add_argument("--quick", action="store_true", help="small test sets, for a look and for the tests")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the report, CSV files and plots")
    arguments = parser.parse_args()
    console = Console(width=max(Console().width, LEAST_WIDTH))
    try:
        results = compare(arguments.quick)
    except BenchmarkFailure as failure:
        console.print(f"[bold red]Stopped, nothing written:[/] {failure}")
        return 1
    arguments.out.mkdir(parents=True, exist_ok=True)
    figures.draw(results, arguments.out)
    report.write(results, arguments.out)
    console.print(main_table(results))
    console.print(f"Written to {arguments.out}: {report.NAME}.md, its CSV files and plots.")
    return 0


def main_table(results: Results) -> Table:
    table = Table(caption=EXPLAINED, caption_justify="left")
    for column in HEADER:
        table.add_column(column, justify="right" if column else "left", no_wrap=not column)
    for row in summary(results):
        table.add_row(*row)
    return table


if __name__ == "__main__":
    raise SystemExit(main())
