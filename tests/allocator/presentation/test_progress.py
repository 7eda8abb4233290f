"""Progress of long work: lines in pipes, a bar in a terminal."""

import pytest

from allocator.presentation import progress
from allocator.presentation.progress import counted


def test_progress_is_told_in_lines_where_there_is_no_terminal(capsys, monkeypatch):
    assert list(counted(range(3), "simulating")) == [0, 1, 2]
    assert capsys.readouterr().err == ""  # what takes no time needs no words
    monkeypatch.setattr(progress, "_TELLS", 0.0)
    assert list(counted(iter("abc"), "simulating", 3)) == ["a", "b", "c"]
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(",")[0] for line in lines] == [f"simulating: {k} of 3" for k in (1, 2, 3)]
    assert all(line.endswith("s left") for line in lines)


@pytest.mark.parametrize(("items", "total"), [("abc", None), (iter("abc"), None), (iter("abc"), 3)])
def test_progress_is_a_bar_in_a_terminal(items, total, capfd, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes the captured stream for a terminal
    assert list(counted(items, "drawing", total)) == ["a", "b", "c"]
    shown = capfd.readouterr()
    assert shown.out == ""
    assert "drawing" in shown.err
