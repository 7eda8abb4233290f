"""Report on the prose of pages and docstrings: `python tests/project/prose.py` (needs the extra `dev`).

Per page: words, the automated readability index (about the years of school that a reader needs), the longest sentence,
and the hinges of sentences that CONTRIBUTING advises against, per 10 000 words. Then the spelling errors that
codespell finds. It judges nothing; a person does.
"""

import ast
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
HINGES = "what", "who", "that which", "here", "besides", "too"
NOT_PROSE = re.compile(
    r"```.*?```|^(?: {4}|\||#|!\[|\{\{).*?$|`[^`]*`|\]\([^)]*\)|[*_\[\]<>]", re.DOTALL | re.MULTILINE
)
SENTENCE = re.compile(r"(?<=[.:;!?])\s+")
SPELLED = "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs", "allocator", "mpc", "examples", "notebooks"


def pages() -> dict[str, str]:
    """Return the prose of each page, and of all docstrings of each package."""
    files = [ROOT / name for name in SPELLED if name.endswith(".md")] + sorted((ROOT / "docs").rglob("*.md"))
    made = {file.relative_to(ROOT).as_posix(): NOT_PROSE.sub(" ", file.read_text(encoding="utf-8")) for file in files}
    for package in ("allocator", "mpc"):
        texts = [docstrings(file.read_text(encoding="utf-8")) for file in sorted((ROOT / package).rglob("*.py"))]
        made[f"docstrings of {package}"] = "\n\n".join(texts)
    return made


def docstrings(source: str) -> str:
    """Return the docstrings of a module without their literals."""
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef
    found = [ast.get_docstring(node) or "" for node in ast.walk(ast.parse(source)) if isinstance(node, kinds)]
    return "\n\n".join(re.sub(r"`[^`]*`", " ", text) for text in found)


def line(name: str, text: str) -> str:
    """Return a row of the table."""
    words = re.findall(r"[A-Za-z'-]+", text)
    hinges = [len(re.findall(rf"\b{hinge}\b", text, re.IGNORECASE)) * 10_000 / max(len(words), 1) for hinge in HINGES]
    sentences = SENTENCE.split(text)
    longest, index = max(len(sentence.split()) for sentence in sentences), readability(words, len(sentences))
    counts = "".join(f"{number:8.0f}" for number in hinges)
    return f"{name:38} {len(words):7} {index:6.1f} {longest:8} {counts}"


def readability(words: list[str], sentences: int) -> float:
    """Return the automated readability index (Senter and Smith, AMRL-TR-66-220, 1967)."""
    return 4.71 * sum(map(len, words)) / max(len(words), 1) + 0.5 * len(words) / sentences - 21.43


def main() -> None:
    """Print the tables."""
    print(f"{'page':38} {'words':>7} {'index':>6} {'longest':>8} " + "".join(f"{hinge[:7]:>8}" for hinge in HINGES))
    made = pages()
    for name, text in made.items():
        print(line(name, text))
    print(line("all", "\n\n".join(made.values())))
    print("\nSpelling:", flush=True)
    subprocess.run([sys.executable, "-m", "codespell_lib", *SPELLED], cwd=ROOT, check=False)


if __name__ == "__main__":
    main()
