"""Another process compiles: once, by whoever comes first, and where it comes to nothing the next one does it itself."""

import os
from pathlib import Path
from time import monotonic, sleep

import pytest

from allocator.compilation import beside
from allocator.compilation.cache import clear_stale


def until(true, seconds=60.0):
    """Wait until it is true."""
    end = monotonic() + seconds
    while not true():
        assert monotonic() < end
        sleep(0.02)


def ended():
    """The process that was started last has ended; its exit code."""
    return beside._STARTED[-1].wait(timeout=60)


def test_the_work_is_done_by_another_process_which_leaves_nothing_else(tmp_path):
    made = tmp_path / "made"
    assert beside.begin("work", tmp_path, Path.write_text, made, "done")
    assert ended() == 0
    assert made.read_text() == "done"
    assert [*tmp_path.iterdir()] == [made]


def test_work_that_failed_is_left_to_the_next_one(tmp_path):
    assert beside.begin("work", tmp_path, Path.read_text, tmp_path / "nothing")
    assert ended() != 0
    assert not beside.begin("work", tmp_path, Path.touch, tmp_path / "made")
    assert not (tmp_path / "made").exists()


def test_while_a_process_is_at_it_no_other_one_begins_and_its_end_is_seen(tmp_path):
    lock = tmp_path / "work.lock"
    assert beside.begin("work", tmp_path, sleep, 60.0)
    first = beside._STARTED[-1]
    until(lambda: lock.exists() and beside._held(lock))
    assert beside.begin("work", tmp_path, Path.touch, tmp_path / "made")
    assert beside._STARTED[-1] is first
    first.kill()
    first.wait(timeout=60)
    assert not beside.begin("work", tmp_path, Path.touch, tmp_path / "made")
    assert not (tmp_path / "made").exists()


def test_of_two_that_begin_at_a_time_one_does_the_work(tmp_path):
    lock = tmp_path / "work.lock"
    with lock.open("ab") as file:
        assert beside.locked(file)
        beside._start(beside.pickle.dumps((lock, Path.touch, (tmp_path / "made",))), tmp_path)
        assert ended() == 0
    assert [*tmp_path.iterdir()] == [lock]


@pytest.mark.parametrize("failure", ["no directory", "no Python", "nothing to hand over"])
def test_where_no_process_can_begin_the_work_is_the_caller_s(tmp_path, monkeypatch, failure):
    place, work = tmp_path, Path.touch
    if failure == "no directory":
        place = tmp_path / "nowhere"
    elif failure == "no Python":
        monkeypatch.setattr(beside.sys, "executable", str(tmp_path / "python"))
    else:
        work = lambda path: None  # noqa: E731  # no other process finds it
    assert not beside.begin("work", place, work, tmp_path / "made")


def test_other_versions_are_cleared_when_nobody_has_used_them_for_a_week(tmp_path):
    kept = tmp_path / "__pycache__"
    kept.mkdir()
    week = 8 * 86400.0
    files = {  # by name: whether it is cleared, and its age
        "ours_old_1.py": (True, week),
        "ours_old_1.lock": (True, week),
        "__pycache__/ours_old_1.f-1.py311.abc.kept": (True, week),
        ".ours_new_2-0123.py": (True, week),  # somebody was interrupted
        "ours_old_2.py": (False, week),
        "__pycache__/ours_old_2.f-1.py311.abc.kept": (False, 60.0),  # another environment uses it
        "ours_new_1.py": (False, week),
        "__pycache__/ours_new_1.f-1.py311.abc.kept": (False, week),
        "theirs.py": (False, week),
        "__pycache__/theirs.pyc": (False, week),
    }
    for name, (_, age) in files.items():
        (tmp_path / name).touch()
        then = (tmp_path / name).stat().st_mtime - age
        os.utime(tmp_path / name, (then, then))
    clear_stale(tmp_path, "ours_", "ours_new_")
    assert {name for name in files if not (tmp_path / name).exists()} == {n for n, (gone, _) in files.items() if gone}
