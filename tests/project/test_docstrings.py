"""Every public docstring stands alone: its first sentence has a verb. Of functions ruff asks for the imperative."""

import ast
import importlib
import pkgutil
import re

import pytest

import allocator
import mpc

VERBS = frozenset(  # that the sentences use; add yours
    re.findall(
        r"\w+",
        """
        answer answers are assess become becomes brings cannot come comes compiles contains control decides depend
        describe describes does drives ends fails feed fills find finds follows gives go goes has have hold holds is
        keep keeps knows leads lies
        limits list lists load make makes may multiply name names needs plot print project pulls raise raises read
        proves record records refuses remembers repeat report rest return returns route run runs sample say says search
        serves show shows solves stand stays step takes tell tells turns works write writes
        """,
    )
)


def modules():
    for package in (allocator, mpc):
        yield package.__name__
        yield from (m.name for m in pkgutil.walk_packages(package.__path__, f"{package.__name__}."))


def first_sentences(node, name):
    """(name, first sentence) of the module or class and of all that is public in it."""
    if document := ast.get_docstring(node):
        yield name, re.split(r"(?<=[.;:])\s", document.partition("\n\n")[0].replace("\n", " "))[0]
    for part in node.body:
        if isinstance(part, ast.ClassDef | ast.FunctionDef) and not part.name.startswith("_"):
            yield from (
                first_sentences(part, f"{name}.{part.name}") if isinstance(part, ast.ClassDef) else said(part, name)
            )


def said(function, name):
    if any("property" in ast.unparse(decorator) for decorator in function.decorator_list):
        yield f"{name}.{function.name}", (ast.get_docstring(function) or "").partition("\n\n")[0]


@pytest.mark.parametrize("name", list(modules()))
def test_every_first_sentence_has_a_verb(name):
    with open(importlib.import_module(name).__file__, encoding="utf-8") as file:
        tree = ast.parse(file.read())
    bare = [
        (where, sentence)
        for where, sentence in first_sentences(tree, name)
        if not VERBS & set(re.findall(r"[a-z]+", re.sub(r"`[^`]*`", "", sentence).lower()))
    ]
    assert bare == []
