"""The help of every command fits on a screen, and --help-all leaves nothing out."""

import re

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from mpc.cli import app

SCREEN = {"COLUMNS": "80", "TERM": "dumb"}
WIDTH = 78  # which click leaves of a terminal with 80 columns, but not in its test runner


def commands():
    """Yield (names, command) of every command, also of those in groups."""
    for name, command in get_command(app).commands.items():
        yield from (((name, own), inner) for own, inner in getattr(command, "commands", {}).items())
        if not hasattr(command, "commands"):
            yield (name,), command


COMMANDS = dict(commands())


def printed(*arguments):
    result = CliRunner().invoke(app, arguments, env=SCREEN, terminal_width=WIDTH)
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("names", [(), ("export",), *COMMANDS], ids=" ".join)
def test_the_help_has_at_most_40_lines_of_80_characters(names):
    lines = printed(*names, "--help").splitlines()
    assert 3 < len(lines) <= 40
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize("names", COMMANDS, ids=" ".join)
def test_the_short_help_names_every_option_and_the_long_one_describes_it(names):
    short, whole = printed(*names, "--help"), " ".join(printed(*names, "--help-all").split())
    for option in COMMANDS[names].params:
        if option.param_type_name == "option":
            assert re.search(rf"(?<![\w-]){re.escape(option.opts[0])}(?![\w-])", short), option.opts
        assert " ".join(option.help.split()) in whole.replace("- ", "-") or option.help in whole, option.opts


def test_the_command_alone_shows_five_things_to_do():
    shown = re.findall(r"^  antagonist (\S+)", printed(), re.MULTILINE)
    assert len(shown) == 5
    assert all((name,) in COMMANDS for name in shown)
