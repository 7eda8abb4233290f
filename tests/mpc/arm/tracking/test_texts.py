"""The texts that are assembled for an arm give every name one meaning."""

import ast
from collections import defaultdict
from pathlib import Path

import pytest

from mpc.model.arm.model import Arm
from mpc.tracking.compiled.arm.module import compiled_arm, solve_module

pytestmark = pytest.mark.compiles

ARM = Arm.machine("arm26")


def meanings(text):
    """Return the meanings of each name of a module."""
    found = defaultdict(set)
    for node in ast.parse(text).body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            for name in node.names:
                found[name.asname or name.name].add((getattr(node, "module", None), name.name))
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            found[node.name].add(node.lineno)
        else:
            for part in ast.walk(node):
                if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
                    found[part.id].add(node.lineno)
    return found


@pytest.mark.parametrize("made", [lambda: compiled_arm(ARM, 0.01).step, lambda: solve_module(ARM)], ids=["step", "QP"])
def test_no_name_is_given_twice(made):
    found = meanings(Path(made().__file__).read_text(encoding="utf-8"))
    assert len(found) > 50
    assert {name: places for name, places in found.items() if len(places) > 1} == {}


def test_a_name_that_is_given_twice_is_noticed():
    assert len(meanings("from some import name\n\n\ndef name():\n    pass\n")["name"]) == 2
