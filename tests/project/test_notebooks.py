"""The notebooks run from a clean kernel, ask a question, use the public face, and leave the reader something to do."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

import allocator

from ..rigs.said import besides_compiling

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
MOST_BYTES = 300_000


def test_all_of_them_are_there():
    assert [path.name[:2] for path in NOTEBOOKS] == [f"{n:02d}" for n in range(1, 14)]


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs_from_a_clean_kernel_without_warnings(path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(Path(allocator.__file__).parent.parent))  # the package under test
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": FOLDER}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert not "".join(besides_compiling(output.text) for output in outputs if output.get("name") == "stderr")
    assert any("image/png" in output.get("data", {}) for output in outputs)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_opens_with_a_question_and_ends_with_something_to_do(path):
    first, *_, last = nbformat.read(path, as_version=4).cells
    assert first.source.splitlines()[0].startswith("# ")
    assert first.source.splitlines()[0].endswith("?")
    assert "**Exercise.**" in last.source
    assert "**Next" in last.source


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_uses_only_public_names_and_holds_no_logic(path):
    source = "\n".join(c.source for c in nbformat.read(path, as_version=4).cells if c.cell_type == "code")
    imported = re.findall(r"^(?:from (\S+) import|import (\S+))", source, re.MULTILINE)
    for module in {a or b for a, b in imported}:
        assert module.split(".")[0] in {"allocator", "mpc", "numpy"} or module in {"sys", "benchmarks.report_figures"}
        assert not any(part.startswith("_") for part in module.split("."))
    assert "class " not in source
    assert len(re.findall(r"^def ", source, re.MULTILINE)) <= 1  # what a slider draws


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_its_outputs_are_small_and_tell_nothing_of_the_machine(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.encode()) < MOST_BYTES
    assert not re.search(r"/(tmp|home|work|root|Users)/", text)
