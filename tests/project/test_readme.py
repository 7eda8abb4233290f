"""The README's Python runs and prints what it says."""

import contextlib
import io
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mpc.cli import app

README = (Path(__file__).parents[2] / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.compiles
@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.splitlines()[0])
def test_the_block_runs_and_prints_what_its_comments_say(block):
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(block, {})
    lines = iter(printed.getvalue().splitlines())
    for line in block.splitlines():
        if not line.startswith("print("):
            continue
        code, _, comment = line.partition("  # ")
        output = next(lines)
        if "…" in comment:  # numbers, shortened
            assert all(piece.strip() in output for piece in comment.split("…")), f"{code} printed {output}"


def test_every_image_of_the_readme_exists():
    images = re.findall(r"!\[.*?\]\((.*?)\)", README)
    assert images
    assert all((Path(__file__).parents[2] / image).is_file() for image in images)


def test_the_plan_beside_its_command_is_what_it_prints(tmp_path):
    command = re.search(r"^    antagonist (plan-joint .*) --out plan\.csv$", README, re.MULTILINE).group(1)
    said = re.search(r"`(\d+ setpoints, [^`]+)`", README).group(1)
    result = CliRunner().invoke(app, [*command.split(), "--out", str(tmp_path / "plan.csv")])
    assert result.exit_code == 0, result.output
    assert " ".join(said.split()) in " ".join(result.output.split())


MEASURED = re.findall(r"\| ([\d.]+)°, ([\d.]+) % \| `antagonist (track [^`]+) --out \S+` \|$", README, re.MULTILINE)


@pytest.mark.compiles
@pytest.mark.parametrize(("angle", "stiffness", "command"), MEASURED, ids=lambda value: value.split()[-1])
def test_the_tracking_error_beside_a_command_is_what_it_prints(angle, stiffness, command, tmp_path):
    result = CliRunner().invoke(app, [*command.split(), "--out", str(tmp_path / "run.csv")])
    assert result.exit_code == 0, result.output
    printed = re.search(
        r"after the first rest\D+4 s.*?angle error \[°\]\D+([\d.]+).*?stiffness error \[%\]\D+([\d.]+)",
        result.output,
        re.DOTALL,
    )
    assert [float(p) for p in printed.groups()] == pytest.approx([float(angle), float(stiffness)], rel=0.03)


def test_every_figure_has_its_command():
    table = README.partition("## Measured")[2].partition("## ")[0]
    rows = [line.split("|")[1:-1] for line in table.splitlines() if line.startswith("| ")][1:]
    assert len(MEASURED) == 2
    assert all(re.search(r"`(antagonist|python -m benchmarks)[ .][^`]+`", row[2]) for row in rows)
    assert all("](benchmarks/results/" in row[1] for row in rows if "python -m" in row[2])
