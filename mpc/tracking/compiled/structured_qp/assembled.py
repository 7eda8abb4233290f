"""The structured QP as one text for any sizes: the files of this folder, joined, with these sizes in the first line."""

import ast
from pathlib import Path

_HERE = Path(__file__).parent
_OWN = "mpc.tracking.compiled.structured_qp", "mpc.tracking.compiled.commands"
_FILES = (
    "sizes",
    "stage_of_many",
    "../commands",
    "newton",
    "riccati",
    "rows",
    "certificate",
    "responses",
    "exchange",
    "active_set",
    "multipliers",
    "interior",
    "solve",
)


def assembled(joints: int, muscles: int, stiffnesses: int) -> str:
    """Return the text of the QP's solution for these sizes: its function `decide` and all that this calls."""
    parts = [without_own_imports(_HERE / f"{name}.py") for name in _FILES]
    first, sizes = "JOINTS, NU, STIFFNESSES = ", f"{joints}, {muscles}, {stiffnesses}"
    lines = [f"{first}{sizes}\n" if line.startswith(first) else line for line in parts[0].splitlines(keepends=True)]
    return "\n\n".join(["".join(lines), *parts[1:]]).replace("@merged", "@inlined_flat")


def without_own_imports(file: Path) -> str:
    """Return the text of a file without its docstring and what it imports from the others."""
    text = file.read_text(encoding="utf-8")
    lines, body = text.splitlines(keepends=True), ast.parse(text).body
    left_out = body[:1] + [n for n in body if isinstance(n, ast.ImportFrom) and (n.module or "").startswith(_OWN)]
    for node in left_out:
        for line in range(node.lineno - 1, node.end_lineno or node.lineno):
            lines[line] = ""
    return "".join(lines).strip("\n") + "\n"
