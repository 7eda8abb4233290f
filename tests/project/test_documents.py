"""What the documents name is there."""

import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCUMENTS = [
    "README.md",
    "CONTRIBUTING.md",
    *sorted(file.relative_to(ROOT).as_posix() for file in (ROOT / "docs").rglob("*.md")),
]


def test_every_file_and_folder_named_in_a_document_exists():
    for document in DOCUMENTS:
        named = re.findall(r"`((?:allocator|mpc|tests|benchmarks|examples)/[\w/.]*)`", (ROOT / document).read_text())
        assert [path for path in named if not (ROOT / path).exists()] == [], document


def test_every_link_within_the_project_leads_somewhere():
    for document in DOCUMENTS:
        links = re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", (ROOT / document).read_text())
        assert [link for link in links if not ((ROOT / document).parent / link).exists()] == [], document


def test_no_line_and_no_row_of_a_table_stands_twice():
    """Two branches that both add to a list leave both, when they are merged, in one document."""
    for document in [*DOCUMENTS, "CHANGELOG.md"]:
        text = re.sub(r"^(```|~~~).*?^\1", "", (ROOT / document).read_text(), flags=re.MULTILINE | re.DOTALL)
        prose = [line for line in text.splitlines() if len(line) > 40 and not line.startswith(("    ", "|--", "|:-"))]
        rows = [cell for cell in re.findall(r"^\| (`[^|]*`) \|", text, re.MULTILINE) if "/" in cell]
        names = re.findall(r"^- `((?:mpc|allocator)[\w.]*)`:", text, re.MULTILINE)
        assert [line for line, n in Counter([*prose, *rows, *names]).items() if n > 1] == [], document
