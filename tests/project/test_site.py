"""The site's pages run: every block of Python and every command, in order, in an empty folder with the examples."""

import contextlib
import io
import re
import shlex
import shutil
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from mpc.cli import app

ROOT = Path(__file__).parents[2]
PAGES = sorted(p.relative_to(ROOT / "docs").as_posix() for p in (ROOT / "docs").rglob("*.md"))
BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if BLOCK.search((ROOT / "docs" / p).read_text())])
def test_the_blocks_of_a_page_run_in_their_order(page, tmp_path, monkeypatch):
    if (ROOT / "examples").is_dir():
        shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for language, block in BLOCK.findall((ROOT / "docs" / page).read_text()):
        if language == "python":
            run_python(block, names)
        else:
            run_commands(block)


def run_python(block, names):
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(block, names)
    lines = iter(printed.getvalue().splitlines())
    for line in block.splitlines():
        if line.startswith("print("):
            output = next(lines)
            _, _, comment = line.partition("  # ")
            assert all(piece.strip() in output for piece in comment.split("…")), f"{line} printed {output}"


def run_commands(block):
    for line in block.splitlines():
        program, *given = shlex.split(line)
        assert program == "antagonist", line
        result = CliRunner().invoke(app, given)
        assert result.exit_code == 0, f"{line}: {result.output}"


class Loader(yaml.SafeLoader):
    """A loader that does not look up Python names."""


Loader.add_multi_constructor("tag:yaml.org,2002:python/name:", lambda loader, suffix, node: suffix)


def test_every_page_and_notebook_is_in_the_navigation():
    def pages(entry):
        if isinstance(entry, str):
            return [entry]
        inner = entry.values() if isinstance(entry, dict) else entry
        return [page for part in inner for page in pages(part)]

    shown = pages(yaml.load((ROOT / "mkdocs.yml").read_text(), Loader)["nav"])
    notebooks = [f"tutorials/{path.stem}.md" for path in (ROOT / "notebooks").glob("*.ipynb")]
    reports = [f"benchmarks/{path.name}" for path in (ROOT / "benchmarks" / "results").glob("*.md")]
    assert sorted(shown) == sorted([*PAGES, *notebooks, *reports, "changes.md"])
