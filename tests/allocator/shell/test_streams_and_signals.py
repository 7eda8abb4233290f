"""`antagonist` among other programs: its streams, its signals, and what nobody foresaw."""

import collections
import json
import os
import signal
import subprocess
import sys
import time

import pytest

from allocator.shell import failures
from mpc import NonlinearMPC, Plant

COMMAND = [sys.executable, "-m", "mpc"]
ALLOCATE = [*COMMAND, "allocate", "--theta", "30", "--stiffness", "7.5"]


def shell(line, **variables):
    """Run a line of sh in which "$@" is `antagonist allocate` with sensible arguments."""
    command = ["sh", "-c", line, "antagonist", *ALLOCATE]
    return subprocess.run(
        command, capture_output=True, encoding="utf-8", errors="replace", env={**os.environ, **variables}
    )


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_terminal_without_greek_letters_gets_question_marks(encoding):
    done = shell('"$@" && "$@" --help', PYTHONIOENCODING=encoding)
    assert done.returncode == 0
    assert done.stderr == ""
    assert "stiffness [N" in done.stdout


def test_a_full_standard_output_is_said():
    done = shell('"$@" > /dev/full')
    assert done.returncode == 1
    assert done.stderr == "antagonist: standard output cannot be written (No space left on device)\n"


def test_a_closed_standard_output_is_said():
    done = shell('"$@" >&-')
    assert done.returncode == 1
    assert done.stderr == "antagonist: standard output is closed\n"


def test_who_stops_reading_is_not_bothered():
    done = shell('{ "$@"; echo $? >&2; } | true')
    assert done.stderr == "1\n"


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.15, 0.3, 0.6])
def test_an_interrupt_while_loading_is_one_word(delay, tmp_path):
    """Of 0.15 s and more: before that Python itself is starting. A shell shows both exit codes as 130."""
    process = subprocess.Popen(
        [*COMMAND, "track", "sine", "--controller", "nmpc"], stderr=subprocess.PIPE, stdout=subprocess.PIPE,
        text=True, cwd=tmp_path, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert said == "antagonist: interrupted\n"
    assert process.returncode in (130, -signal.SIGINT)  # the second where Python itself was executing a string


def test_an_interrupt_at_work_is_one_word(capsys):
    def work():
        raise KeyboardInterrupt

    assert failures.run(work) == 130
    assert capsys.readouterr().err == "antagonist: interrupted\n"


def test_an_interrupt_inside_ipopt_is_not_taken_for_a_failed_solution():
    controller, x = NonlinearMPC(Plant(), N=40), Plant().at_rest(0.0, 7.6)
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_REAL, 0.5)
    try:
        with pytest.raises(KeyboardInterrupt):
            collections.deque((controller.step(x, 0.3, 8.0) for _ in range(100)), maxlen=0)  # some 10 s
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_what_nobody_foresaw_is_one_line_with_where_to_report_it(capsys, monkeypatch):
    def work():
        raise ZeroDivisionError("float division\nby zero")

    monkeypatch.delenv("ANTAGONIST_DEBUG", raising=False)
    assert failures.run(work) == 1
    said = capsys.readouterr().err
    assert "ZeroDivisionError: float division by zero" in said
    assert "issue" in said
    assert said.count("\n") == 1
    monkeypatch.setenv("ANTAGONIST_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        failures.run(work)


def test_missing_memory_is_said(capsys):
    def work():
        raise MemoryError("Unable to allocate 26.8 GiB")

    assert failures.run(work) == 1
    assert capsys.readouterr().err == "antagonist: the memory does not suffice (Unable to allocate 26.8 GiB)\n"


def test_json_is_all_that_stands_on_standard_output():
    done = shell('"$@" --json')
    answer = json.loads(done.stdout)
    assert answer["status"] == "EXACT"
    assert answer["stiffness_Nm_per_rad"] == pytest.approx(7.5)
    assert done.stderr == ""


@pytest.mark.slow
def test_the_exit_code_tells_whether_the_target_is_met():
    assert shell('"$@"').returncode == 0
    assert shell('"$@" --torque 50').returncode == 3
    assert shell('"$@" --torque 50 --json').returncode == 3


def test_the_version_is_the_package_s():
    done = shell('"$1" -m mpc --version')
    assert done.stdout.startswith("antagonist 0.")


@pytest.mark.slow
def test_completion_can_be_installed():
    done = shell('"$1" -m mpc --show-completion bash; "$1" -m mpc --help')
    assert "--install-completion" in done.stdout


def test_a_gl_that_does_not_exist_is_named_with_those_that_do():
    imported = "from allocator.shell import failures; raise SystemExit(failures.run(lambda: __import__('mujoco')))"
    env = os.environ | {"MUJOCO_GL": "vulkan"}
    done = subprocess.run([sys.executable, "-c", imported], capture_output=True, text=True, env=env)
    assert done.returncode == 2
    assert done.stderr.startswith("antagonist: MUJOCO_GL = 'vulkan' cannot be used (RuntimeError: invalid value")
    assert done.stderr.endswith("choose another of egl, osmesa and glfw, or unset it\n")
