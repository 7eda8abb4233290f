"""Long work reports that it goes on, short work prints nothing."""

import sys
from time import sleep

import pytest

from allocator.presentation import progress as module
from allocator.presentation.progress import waiting


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(module, "_TERMINAL", 0.01)
    monkeypatch.setattr(module, "_PIPE", 0.01)


def test_short_work_prints_nothing(capsys):
    with waiting("compiling"):
        pass
    assert capsys.readouterr() == ("", "")


@pytest.mark.usefixtures("impatient")
def test_a_pipe_gets_lines(capsys):
    with waiting("compiling"), waiting("a part of it"):
        sleep(0.1)
    out, err = capsys.readouterr()
    assert out == ""
    assert set(err.splitlines()) == {"compiling: 0 s"}
    assert err.endswith("\n")


@pytest.mark.usefixtures("impatient")
def test_a_terminal_gets_one_line_that_is_removed_also_after_an_error(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)

    def work():
        with waiting("compiling"):
            sleep(0.1)
            raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        work()
    parts = capsys.readouterr().err.split("\r")
    assert set(parts[:-2]) == {"compiling: 0 s"}
    assert (parts[-2].strip(), parts[-1]) == ("", "")
