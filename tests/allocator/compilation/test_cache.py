"""Compiled code that is kept on disk works whatever becomes of its files, and one line says so."""

import gc
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError

from allocator.compilation import cache, jit
from allocator.compilation.cache import Refused, check_own
from mpc import Plant, TrackingMPC
from mpc.tracking.compiled import module

from ...rigs.said import besides_compiling

ROOT = Path(__file__).parents[3]
DOUBLE = "def double(x):\n    return 2.0 * x\n"
CALL = """
import sys, warnings
sys.path.insert(0, sys.argv[1])
from allocator.compilation import jit
from doubling import double
if "full" in sys.argv:
    import resource, signal
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    made = jit.compiled(double, (), inline=False, unaliased=False)
    values = [made(x) for x in (1.5, 3, True)] if made else []
print(values, sum(made.stats.cache_hits.values()) if made else 0)
for w in said:
    print(w.category.__name__, w.filename, w.message)
"""


def run(text, *arguments, **variables):
    """A Python of its own; `lines` waits for what it prints."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": "", **variables}
    return subprocess.Popen(
        [sys.executable, "-c", text, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=environment, cwd=ROOT,
    )  # fmt: skip


def lines(process):
    """What it prints; it must say nothing else, but for the seconds of its compilation."""
    out, err = process.communicate(timeout=300)
    assert (process.returncode, besides_compiling(err)) == (0, "")
    return out.splitlines()


@pytest.fixture(autouse=True)
def beside_the_file(monkeypatch):
    """In this process, too, whatever NUMBA_CACHE_DIR is where the tests run."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A module, and what was kept of it."""
    folder = tmp_path_factory.mktemp("filled")
    (folder / "doubling.py").write_text(DOUBLE)
    assert lines(run(CALL, str(folder))) == ["[3.0, 6.0, 2.0] 0"]
    assert lines(run(CALL, str(folder))) == ["[3.0, 6.0, 2.0] 3"]
    return folder


def flipped(content):
    return content[:2000] + bytes([content[2000] ^ 1]) + content[2001:]


FAULTS = {
    "truncated": lambda content: content[: len(content) // 2],
    "empty": lambda content: b"",
    "garbage": lambda content: np.random.default_rng(0).bytes(3000),
    "a bit flipped": flipped,
    "its hash alone": lambda content: content[:32],
}


@pytest.mark.slow
@pytest.mark.parametrize("faults", [tuple(FAULTS)[:3], tuple(FAULTS)[2:]], ids=", ".join)
def test_damaged_files_are_made_anew_and_one_line_says_so(filled, tmp_path, faults):
    folder = shutil.copytree(filled, tmp_path / "copy")
    for file, fault in zip(folder.glob("__pycache__/*.kept"), faults, strict=True):
        file.write_bytes(FAULTS[fault](file.read_bytes()))
    first, *said = lines(run(CALL, str(folder)))
    assert first == "[3.0, 6.0, 2.0] 0"
    [line] = said
    assert line.startswith("CacheFault <string> compiled code in ")  # the user's line
    assert line.endswith(" is damaged and is made anew")
    assert lines(run(CALL, str(folder))) == ["[3.0, 6.0, 2.0] 3"]


@pytest.mark.slow
def test_a_full_disk_is_said_once_and_leaves_nothing(tmp_path):
    (tmp_path / "doubling.py").write_text(DOUBLE)
    first, *said = lines(run(CALL, str(tmp_path), "full", PYTHONDONTWRITEBYTECODE="1"))
    assert first == "[3.0, 6.0, 2.0] 0"
    [line] = said
    assert "cannot be kept" in line
    assert "every new process compiles it again" in line
    assert not [*tmp_path.glob("__pycache__/*")]


@pytest.mark.slow
def test_of_several_that_need_the_same_code_one_compiles_it(tmp_path):
    (tmp_path / "doubling.py").write_text(DOUBLE)
    firsts = [lines(process)[0] for process in [run(CALL, str(tmp_path)) for _ in range(3)]]
    assert {first[:-2] for first in firsts} == {"[3.0, 6.0, 2.0]"}
    assert sum(int(first[-1]) for first in firsts) == 2 * 3  # each signature found by two of them
    assert not [*tmp_path.glob("__pycache__/*.lock")]


def kept(folder, function):
    """The dispatcher of a function, and where its code is kept."""
    (folder / "numbers_of.py").write_text(function)
    return dispatched(folder, function), folder / "__pycache__"


def dispatched(folder, function):
    """A dispatcher of a function in the file that `kept` wrote."""
    names = {}
    exec(compile(function, folder / "numbers_of.py", "exec"), names)
    return jit.compiled(names["function"], (), inline=False, unaliased=False)


def test_code_that_another_process_has_made_since_the_first_look_is_not_compiled_again(tmp_path, monkeypatch):
    function = "def function(x):\n    return 3.0 * x\n"
    made, _ = kept(tmp_path, function)
    other, claimed, begun = dispatched(tmp_path, function), cache._Files.claimed, []

    def late(files, key):
        if not begun:
            begun.append(key)
            other(2.0)  # finished before this process asks for the lock
        return claimed(files, key)

    monkeypatch.setattr(cache._Files, "claimed", late)
    assert made(2.0) == 6.0
    assert sum(other.stats.cache_misses.values()) == 1
    assert (sum(made.stats.cache_hits.values()), sum(made.stats.cache_misses.values())) == (1, 0)


def test_who_waits_in_vain_compiles_itself(tmp_path, monkeypatch):
    made, directory = kept(tmp_path, "def function(x):\n    return 3.0 * x\n")
    monkeypatch.setattr(cache, "_PATIENCE", 0.2)
    asked = []
    monkeypatch.setattr(cache.beside, "locked", lambda file: asked.append(Path(file.name)))
    assert made(2.0) == 6.0
    assert len(asked) > 2
    assert {file.parent for file in asked} == {directory}


def test_nothing_is_locked_or_uncollected_after_code_that_cannot_be_compiled(tmp_path):
    made, directory = kept(tmp_path, "def function(x):\n    return x.nothing\n")
    with pytest.raises(TypingError):
        made(2.0)
    assert gc.isenabled()
    assert not [*directory.iterdir()]


@pytest.mark.slow
def test_what_a_changed_callee_is_part_of_is_compiled_anew(tmp_path):
    (tmp_path / "half.py").write_text("def half(x):\n    return x / 2.0\n")
    (tmp_path / "doubling.py").write_text("from half import half\ndef double(x):\n    return 4.0 * half(x)\n")
    call = CALL.replace("(double, ()", "(double, (half,)").replace("import double", "import double, half")
    assert lines(run(call, str(tmp_path))) == ["[3.0, 6.0, 2.0] 0"]
    assert lines(run(call, str(tmp_path))) == ["[3.0, 6.0, 2.0] 3"]
    (tmp_path / "half.py").write_text("def half(x):\n    return x * 0.25\n")
    assert lines(run(call, str(tmp_path))) == ["[1.5, 3.0, 1.0] 0"]


@pytest.mark.slow
def test_a_changed_number_of_another_module_is_compiled_anew(tmp_path):
    (tmp_path / "doubling.py").write_text("from numbers_of import TWO\ndef double(x):\n    return TWO * x\n")
    for two, answer in (("2.0", "[3.0, 6.0, 2.0] 0"), ("2.0", "[3.0, 6.0, 2.0] 3"), ("4.0", "[6.0, 12.0, 4.0] 0")):
        (tmp_path / "numbers_of.py").write_text(f"TWO = {two}\n")
        # Python's own bytecode would be taken for fresh: same size, perhaps the same second
        assert lines(run(CALL, str(tmp_path), PYTHONDONTWRITEBYTECODE="1")) == [answer]


@pytest.mark.slow
def test_a_directory_in_which_others_may_write_is_refused_and_one_line_says_what_to_do(tmp_path):
    (tmp_path / "doubling.py").write_text(DOUBLE)
    shared = tmp_path / "shared"
    assert lines(run(CALL, str(tmp_path), NUMBA_CACHE_DIR=str(shared)))[0] == "[3.0, 6.0, 2.0] 0"
    [below] = shared.iterdir()
    below.chmod(0o777)
    first, *said = lines(run(CALL, str(tmp_path), NUMBA_CACHE_DIR=str(shared)))
    assert first == "[] 0"
    [line] = said
    assert line.startswith("CacheFault <string> allocate works without compiled code: others may write to")
    assert line.endswith(f"chmod go-w {below}")


@pytest.mark.parametrize(
    ("mode", "uid", "gid", "refused"),
    [
        (0o700, 0, 0, False),
        (0o755, 0, 0, False),
        (0o775, 0, 0, False),  # a group of the user's own
        (0o775, 0, 100, True),
        (0o702, 0, 0, True),
        (0o700, 1, 1, True),
    ],
)
def test_who_may_write_decides(monkeypatch, tmp_path, mode, uid, gid, refused):
    class Directory(type(tmp_path)):
        def stat(self, **kwargs):
            mine = cache.os.geteuid()
            return os.stat_result((0o40000 | mode, 0, 0, 0, mine + uid, mine + uid + gid, 0, 0, 0, 0))

    monkeypatch.setattr(cache.os, "geteuid", lambda: 1000)
    if refused:
        with pytest.raises(Refused, match=r"chmod go-w|another user"):
            check_own(Directory(tmp_path))
    else:
        check_own(Directory(tmp_path))


# --- of a controller --------------------------------------------------------------------------------------------------


STEP = """
import warnings
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    from mpc import Plant, TrackingMPC
    mpc = TrackingMPC(Plant(), N=12)
print(mpc.implementation, *mpc.step(Plant().at_rest(0.0, 7.6), 0.1, 7.61).u.ravel())
for w in said:
    print(w.category.__name__, w.filename, w.message)
"""


@pytest.fixture
def home(tmp_path):
    """A cache directory with all that a controller needs."""
    compiled, there = module.compiled_plant(Plant(), 0.01), tmp_path / "antagonist"
    TrackingMPC(Plant(), N=12)
    (there / "__pycache__").mkdir(parents=True, mode=0o700)
    there.chmod(0o700)
    for text in (compiled.step, module.solve_module()):
        file = Path(text.__file__)
        shutil.copy2(file, there)
        for one in file.parent.glob(f"__pycache__/{file.stem}.*"):
            shutil.copy2(one, there / "__pycache__")
    return tmp_path


def answer():
    return TrackingMPC(Plant(), N=12).step(Plant().at_rest(0.0, 7.6), 0.1, 7.61).u.ravel()


def answered(home, implementation):
    """The lines said beside the right answer."""
    first, *said = lines(run(STEP, XDG_CACHE_HOME=str(home)))
    how, *commands = first.split()
    assert how == implementation
    np.testing.assert_allclose(np.array(commands, float), answer(), atol=0.1)
    return said


@pytest.mark.slow
def test_a_controller_with_damaged_files_is_compiled_and_one_line_says_so(home):
    assert answered(home, "compiled") == []
    [file] = home.glob("antagonist/__pycache__/*.step-*.kept")
    file.write_bytes(flipped(file.read_bytes()))
    text = home / "antagonist" / f"{file.name.partition('.')[0]}.py"  # the other text would compile as long again
    text.write_text("raise SystemExit('this is not what was written')\n")
    [line] = answered(home, "compiled")
    assert line.startswith("CacheFault <string> compiled code in ")
    assert answered(home, "compiled") == []


@pytest.mark.slow
def test_a_controller_s_directory_in_which_others_may_write_is_refused(home):
    (home / "antagonist").chmod(0o777)
    [line] = answered(home, "readable")
    assert line.startswith("SlowStep <string> the controller's step is not compiled")
    assert line.endswith(f"chmod go-w {home / 'antagonist'}")


@pytest.mark.slow
def test_a_controller_without_a_directory_to_write_to_is_readable_and_one_line_says_so(tmp_path):
    (tmp_path / "antagonist").write_text("a file")
    [line] = answered(tmp_path, "readable")
    assert line.startswith("SlowStep <string> the controller's step is not compiled")
