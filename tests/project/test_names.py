"""Every module, class, function and file that documents, reports and docstrings name exists."""

import ast
import importlib
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("allocator", "mpc", "benchmarks", "tests", "examples", "docs")
DOTTED = re.compile(r"(?<![\w./`-])(?:`)?((?:allocator|mpc|benchmarks)(?:\.[A-Za-z_]\w*)+)(?![\w/])")
FILE = re.compile(r"`([\w./-]*\w\.(?:py|c|h))`")
WRITTEN = ("csv", "gif", "json", "md", "npz", "png", "toml")  # names of files that a command writes
EXPORTED = {
    "antagonist_config.h",
    "kernel.c",
    "kernel.h",
    "math.h",
    "protocol.h",
    "recursions.c",
    "recursions.h",
    "resting.c",
    "resting.h",
}  # of C, or in folders that `export` writes


def documents():
    """Yield (name, text) of every document and report."""
    for pattern in ("README.md", "CONTRIBUTING.md", "docs/**/*.md", "benchmarks/results/*.md"):
        for path in sorted(ROOT.glob(pattern)):
            yield path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")


def docstrings():
    """Yield (file, text) of all docstrings of a module."""
    for folder in ("allocator", "mpc", "benchmarks", "tests"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            nodes = (n for n in ast.walk(tree) if isinstance(n, ast.Module | ast.ClassDef | ast.FunctionDef))
            yield path.relative_to(ROOT).as_posix(), "\n".join(ast.get_docstring(node) or "" for node in nodes)


@cache
def exists(name):
    """True if a module or one of its members has this dotted name; fields and attributes of `self` count."""
    parts = name.split(".")
    for size in range(len(parts), 0, -1):
        place = ROOT.joinpath(*parts[:size])
        if place.is_dir() or place.with_suffix(".py").is_file():
            break
    else:
        return False
    if size == len(parts):
        return True
    found = importlib.import_module(".".join(parts[:size]))
    for part in parts[size:]:
        if not hasattr(found, part):
            return part in fields(found) and part == parts[-1]
        found = getattr(found, part)
    return True


def fields(kind):
    """Return the names of annotated fields and of attributes that `__init__` sets."""
    annotated = {name for base in getattr(kind, "__mro__", ()) for name in getattr(base, "__annotations__", {})}
    code = getattr(getattr(kind, "__init__", None), "__code__", None)
    return annotated | set(code.co_names if code else ())


@cache
def files():
    """Return the paths of all files of the project."""
    found = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.is_file()]
    return frozenset(f"/{path.relative_to(ROOT).as_posix()}" for path in found)


def missing(texts):
    """Return (where, name) of dotted names and files that are not there."""
    for where, text in texts:
        for name in DOTTED.findall(text):
            if name.split(".")[1] not in WRITTEN and not exists(name):
                yield where, name
        for path in FILE.findall(text):
            known = path in EXPORTED or any(file.endswith(f"/{path.removeprefix('./')}") for file in files())
            if not known:
                yield where, path


def test_every_name_in_a_document_or_report_is_there():
    assert list(missing(documents())) == []


def test_every_name_in_a_docstring_is_there():
    assert list(missing(docstrings())) == []


def test_a_name_that_is_not_there_is_found():
    dead = "see `mpc.tracking.nothing` and `allocator/nowhere.py`, not mpc.csv or `mpc.tracking.cost`"
    assert [name for _, name in missing([("here", dead)])] == ["mpc.tracking.nothing", "allocator/nowhere.py"]
