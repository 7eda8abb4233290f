"""The public names are few, shallow, and the same for Python, tab completion and the reference."""

import importlib
import json
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
TOP = ("allocator", "mpc")
SUBPACKAGES = (
    "allocator.allocation",
    "allocator.feasibility",
    "allocator.identification",
    "allocator.joint",
    "allocator.mechanism",
    "allocator.muscles",
    "allocator.presentation",
    "mpc.arm",
    "mpc.bench",
    "mpc.export",
    "mpc.governor",
    "mpc.learning",
    "mpc.model",
    "mpc.solvers",
    "mpc.trials",
)
FACES = (*TOP, *SUBPACKAGES)
IMPORT = re.compile(r"^[ \t]*(?:from|import) ((?:allocator|mpc)[\w.]*)", re.MULTILINE)


def public(face):
    return set(importlib.import_module(face).__all__)


def documented():
    pages = (path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "reference").glob("*.md"))
    return re.findall(r"^::: (\S+)$", "\n".join(pages), re.MULTILINE)


def test_the_everyday_names_are_about_sixty():
    assert sum(len(public(face)) for face in TOP) <= 66


@pytest.mark.parametrize("face", FACES)
def test_every_public_name_is_there_and_dir_shows_it_alone(face):
    module = importlib.import_module(face)
    values = {name: getattr(module, name) for name in public(face)}
    shown = {name for name in dir(module) if not name.startswith("_")}
    assert set(values) <= shown
    assert [n for n in shown - set(values) if not isinstance(getattr(module, n), ModuleType)] == []


@pytest.mark.parametrize("face", FACES)
def test_the_reference_lists_every_public_name(face):
    module, there = importlib.import_module(face), documented()
    for name in public(face):
        homes = [other for other in FACES if name in public(other)]
        same = [h for h in homes if getattr(importlib.import_module(h), name) is getattr(module, name)]
        assert [f"{home}.{name}" for home in same if f"{home}.{name}" in there], name


def test_the_reference_lists_nothing_else_and_nothing_twice():
    there = documented()
    assert len(there) == len(set(there))
    assert [name for name in there if name.rpartition(".")[2] not in public(name.rpartition(".")[0])] == []


def python_of(path):
    """The Python that a reader sees in a page, an example or a notebook."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return "\n".join(re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
    if path.suffix == ".ipynb":
        return "\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "code")
    return text


def shown():
    yield ROOT / "README.md"
    for pattern in ("docs/**/*.md", "examples/*.py", "notebooks/*.ipynb"):
        yield from (path for path in sorted(ROOT.glob(pattern)) if not path.name.startswith("make_"))


@pytest.mark.parametrize("path", list(shown()), ids=lambda path: path.name)
def test_documents_import_from_public_packages_only(path):
    assert sorted(set(IMPORT.findall(python_of(path))) - set(FACES)) == []
