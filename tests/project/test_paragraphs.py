"""No paragraph stands twice, within a document or in two of them, whole or with a few words changed."""

import re
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
WORDS = 4  # of a shingle
LEAST = 25  # words of a paragraph that is compared
ALIKE = 0.5  # share of the shorter one's shingles that are the other's


def paragraphs(text):
    """Return the paragraphs of prose of a Markdown document: no code, no tables, no headings."""
    text = re.sub(r"^(```|~~~).*?^\1", "", text, flags=re.MULTILINE | re.DOTALL)
    lines = [("" if line.startswith(("    ", "|", "#")) else line) for line in text.splitlines()]
    return re.split(r"\n(?=\s*[*-] |\s*\d+\. |\s*\n)", "\n".join(lines))


def shingles(paragraph):
    """Return the hashes of the runs of `WORDS` words."""
    words = re.findall(r"\w+", paragraph.lower())
    return {hash(tuple(words[i : i + WORDS])) for i in range(len(words) - WORDS + 1)} if len(words) >= LEAST else set()


def alike(documents):
    """Return (document, other document, beginning of the paragraph) of paragraphs that share most of their words."""
    known, holders, found = [], defaultdict(list), []
    for name, text in documents:
        for paragraph in paragraphs(text):
            own, shared = shingles(paragraph), defaultdict(int)
            for shingle in own:
                for other in holders[shingle]:
                    shared[other] += 1
            for other, count in shared.items():
                there, size = known[other]
                if count >= ALIKE * min(len(own), size):
                    found.append((there, name, " ".join(paragraph.split()[:12])))
            for shingle in own:
                holders[shingle].append(len(known))
            known.append((name, len(own)))
    return found


def documents():
    """Yield (name, text) of all documents; reports repeat the sentence of a row, with its figures."""
    for pattern in ("README.md", "CONTRIBUTING.md", "docs/**/*.md"):
        for path in sorted(ROOT.glob(pattern)):
            yield path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")


def test_no_paragraph_stands_in_two_places():
    assert alike(documents()) == []


def test_a_paragraph_that_two_branches_have_changed_is_found():
    mine = (
        "Where nothing is amiss all of this is one compiled call: the layout says what lies where in its flat arrays, "
        "the stages have what the preview does, and what is not ordinary is left to the readable step."
    )
    other = mine.replace("one compiled call", "compiled code").replace("left to", "given to") + "\nThe observer is not."
    assert len(alike([("a", f"# A\n\n{mine}\n\nOther words.\n\n{other}\n")])) == 1
    assert len(alike([("a", mine), ("b", other)])) == 1
    assert alike([("a", mine), ("b", "A paragraph of its own, about something else.")]) == []
