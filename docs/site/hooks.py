"""Additions to the pages of the site: files from other folders, formulas, and lists made from the code."""

import re
from enum import IntEnum
from html import unescape
from pathlib import Path
from posixpath import normpath
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter

from allocator import Limit, Status, report_joint
from allocator.muscles import MODELS, AffineMuscle
from mpc import PlanStatus, Rung
from mpc.explorer.server import saved_page

ROOT = Path(__file__).parents[2]
REPORTS = "benchmarks/results"
ELSEWHERE = {"notebooks": "tutorials", REPORTS: "benchmarks"}  # folders beside docs/, and where on the site they stand
LINK = re.compile(r"(\]\()(?!https?:|#|mailto:)([^)#\s]+)")
PLACEHOLDER = re.compile(r"^\{\{ (\w+) \}\}$", re.MULTILINE)
PICTURE = re.compile(r"^\{\{ picture (\d\d) (\d) (.+) \}\}$", re.MULTILINE)  # notebook, number from 0, caption
PICTURES: dict[str, list[str]] = {}  # files in tutorials/, by notebook
GITHUB = re.compile(r"https://github\.com/([\w.-]+/[\w-]+)/?")
HERE = "<this repository>"  # in a page, for the address
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Files, config: Any) -> Files:
    """Add notebooks, benchmark reports, their pictures and the changelog to the pages of docs/."""
    PICTURES.clear()
    for notebook in sorted((ROOT / "notebooks").glob("*.ipynb")):
        text, resources = MarkdownExporter().from_filename(str(notebook), {"unique_key": notebook.stem})
        text = text.replace("<details>", '<details markdown="1">')  # or Markdown within it stays as it is
        text = text.replace("\n", _in_colab(notebook.stem, config.repo_url), 1)  # below the title
        files.append(File.generated(config, f"tutorials/{notebook.stem}.md", content=text))
        for name, picture in sorted(resources["outputs"].items(), key=_place):
            PICTURES.setdefault(notebook.stem, []).append(name)
            files.append(File.generated(config, f"tutorials/{name}", content=picture))
    for folder, kinds in (("notebooks/images", ("*.png",)), (REPORTS, ("*.md", "*.png"))):
        for file in sorted(path for kind in kinds for path in (ROOT / folder).glob(kind)):
            uri = _site_uri(file.relative_to(ROOT).as_posix())
            files.append(File.generated(config, uri, abs_src_path=str(file)))
    files.append(File.generated(config, "changes.md", abs_src_path=str(ROOT / "CHANGELOG.md")))
    files.append(File.generated(config, "guides/explorer_page.html", content=saved_page(report_joint())))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Fill in the lists, and turn links to files of the project into links to pages."""
    up = "../" * (page.file.src_uri.count("/"))
    markdown = PICTURE.sub(lambda found: _picture(up, found[1], int(found[2]), found[3]), markdown)
    markdown = PLACEHOLDER.sub(lambda found: LISTS[found[1]](), markdown).replace(HERE, config.repo_url or HERE)
    path = page.file.abs_src_path  # None of what was made here of a notebook
    source = Path(path).relative_to(ROOT).parent.as_posix() if path else "notebooks"
    here = Path(page.file.src_uri).parent.as_posix()

    def relinked(found: re.Match[str]) -> str:
        target = normpath(f"{source}/{found[2]}")
        uri = _site_uri(target)
        if files.get_file_from_path(uri) is None:
            return found[0]
        return found[1] + "../" * (0 if here == "." else here.count("/") + 1) + uri

    return LINK.sub(relinked, markdown)


def _place(output: tuple[str, bytes]) -> list[int]:
    """Return cell and number of a notebook's picture, which end its name."""
    return [int(part) for part in re.findall(r"_(\d+)", output[0])[-2:]]


def _in_colab(notebook: str, repository: str | None) -> str:
    """Return a line that opens a notebook in Colab, if `repo_url` in mkdocs.yml is the address of one on GitHub."""
    found = GITHUB.fullmatch(repository or "")
    if found is None:
        return "\n"
    address = f"https://colab.research.google.com/github/{found[1]}/blob/main/notebooks/{notebook}.ipynb"
    return f"\n\n[Open in Colab]({address}){{ .md-button }}\n\n"


def _picture(up: str, notebook: str, number: int, caption: str) -> str:
    """Return a picture of a notebook with a link to it; `up` leads from the page to the top of the site."""
    stem = next(stem for stem in PICTURES if stem.startswith(notebook))
    return f"[![{caption}]({up}tutorials/{PICTURES[stem][number]})]({up}tutorials/{stem}.md)<br>*{caption}*"


def _site_uri(path: str) -> str:
    """Return the address on the site of a file of the project."""
    for folder, at in {**ELSEWHERE, "docs": ""}.items():
        if path.startswith(f"{folder}/"):
            return f"{at}/{path.removeprefix(f'{folder}/')}".removeprefix("/").replace(".ipynb", ".md")
    return {"CHANGELOG.md": "changes.md"}.get(path, path)


_WIDTH = 72  # characters of a line of code in the site's column of text
MACHINE = re.compile(r"\n\nMachine:\n(?:  .*\n?)+")  # the panel that most commands share


def _printed(*command: str) -> str:
    """Return the whole help of a command."""
    from typer.testing import CliRunner

    from mpc.cli import app

    return CliRunner().invoke(app, [*command, "--help-all"], env={"TERM": "dumb"}, terminal_width=_WIDTH).output.strip()


def _shared_options() -> str:
    """Return the panel of options of a machine."""
    found = MACHINE.search(_printed("allocate"))
    assert found is not None
    return f"```text\n{found[0].strip()}\n```"


def _commands() -> str:
    """Return the help of every command, without the panel that they share."""
    from typer.main import get_command

    from mpc.cli import app

    def help_of(*command: str) -> str:
        text = MACHINE.sub("\n\nMachine: as above\n", _printed(*command))
        return f"## antagonist {' '.join(command)}\n\n```text\n{text.strip()}\n```\n"

    found = []
    for name, command in get_command(app).commands.items():  # type: ignore[attr-defined]
        found += [(name, own) for own in getattr(command, "commands", ())] or [(name,)]
    return "\n".join(help_of(*names) for names in found)


def _enumerated(kind: type[IntEnum], column: str, text: str) -> str:
    """Return a table of the members of an enumeration with their texts."""
    rows = (f"| `{member.name}` | {member.value} | {getattr(member, text)} |" for member in kind)
    return f"| {column} | number | means |\n|---|--:|---|\n" + "\n".join(rows)


def _statuses() -> str:
    return _enumerated(Status, "`Status`", "advice")


def _limits() -> str:
    return _enumerated(Limit, "`Limit`", "text")


def _plan_statuses() -> str:
    return _enumerated(PlanStatus, "`PlanStatus`", "text")


def _rungs() -> str:
    return _enumerated(Rung, "`Rung`", "text")


def _models() -> str:
    """Return a table of the muscle models."""
    rows = (
        f"| `{name}` | {model.citation} | {'yes' if issubclass(model, AffineMuscle) else 'no'} |"
        for name, model in sorted(MODELS.items())
    )
    return "| model | source | affine in P |\n|---|---|---|\n" + "\n".join(rows)


LISTS = {
    "commands": _commands,
    "shared_options": _shared_options,
    "statuses": _statuses,
    "limits": _limits,
    "plan_statuses": _plan_statuses,
    "rungs": _rungs,
    "models": _models,
}


def on_page_content(html: str, **_: Any) -> str:
    """Write formulas as MathML, which browsers show without a script."""

    def formula(found: re.Match[str]) -> str:
        if found[1] == "span":
            return convert(unescape(found[2]))
        return f'<div class="formula">{convert(unescape(found[2]), display="block")}</div>'

    return FORMULA.sub(formula, html)
