"""Compiled code is kept until anything that it is made from changes; where there is none, the readable step answers."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from allocator import BAR, Table
from allocator.compilation import beside
from allocator.files import atomic
from mpc import CompilingBeside, PlanStatus, Plant, SlowStep, TrackingMPC
from mpc.codegen import modules
from mpc.codegen import text as printer
from mpc.codegen.graphs import PYTHON
from mpc.codegen.text import translated
from mpc.tracking.compiled import module
from mpc.tracking.compiled.factory import compile_step
from mpc.tracking.linearise import Predictor
from mpc.tracking.qp.step import ReadableQPStep

ROOT = Path(__file__).parents[3]


# --- without ----------------------------------------------------------------------------------------------------------


STEP = """
import sys, warnings
sys.modules.update({"numba": None} if "without" in sys.argv else {})
from allocator.allocation.two_muscles.kernels import kernel
from mpc import Plant, TrackingMPC
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    mpc = TrackingMPC(Plant(), N=12)
print(*(w.category.__name__ for w in said), mpc.implementation, kernel("tondu_exact"))
print(*mpc.step(Plant().at_rest(0.0, 7.6), 0.0, 7.61).u.ravel())
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("argument", "variables"),
    [("without", {}), ("", {"NUMBA_DISABLE_JIT": "1"})],
    ids=["not installed", "told not to compile"],
)
def test_without_numba_the_readable_step_answers_alike_and_says_so_once(argument, variables):
    ran = python(STEP, argument, **variables)
    said, implementation, kernel, *commands = ran.split()
    assert (said, implementation, kernel) == ("SlowStep", "readable", "None")
    mpc = TrackingMPC(Plant(), N=12)
    wanted = mpc.step(Plant().at_rest(0.0, 7.6), 0.0, 7.61).u
    assert np.abs(np.diff(wanted, axis=0)).max() < 0.9 * mpc.limits.step
    np.testing.assert_allclose(np.array(commands, float).reshape(-1, 2), wanted, atol=1e-6 * BAR)


def python(text, *arguments, folder=ROOT, **variables):
    """What a Python of its own prints that works in `folder`; it must say nothing else."""
    command = [sys.executable, "-W", "error", "-c", text, *arguments]
    ran = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=folder, env={**os.environ, **variables}
    )
    assert ran.returncode == 0, ran.stderr
    assert not ran.stderr
    return ran.stdout


@pytest.mark.compiles
def test_without_a_directory_to_write_to_the_readable_step_answers(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setattr(modules, "_directory", lambda: tmp_path / "file" / "below")
    modules.imported.cache_clear()
    with pytest.warns(SlowStep, match="forty times as long"):
        mpc = TrackingMPC(Plant(), N=12)
    assert mpc.implementation == "readable"
    assert mpc.step(Plant().at_rest(0.0, 7.6), 0.1, 7.8).status is PlanStatus.OPTIMAL


@pytest.mark.compiles
def test_the_law_is_written_where_the_user_s_caches_are(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    assert modules._directory() == tmp_path / "antagonist"


@pytest.mark.compiles
@pytest.mark.parametrize("relative", ["", "caches", "./caches"])
def test_a_relative_directory_for_caches_is_ignored(monkeypatch, tmp_path, relative):
    monkeypatch.setenv("XDG_CACHE_HOME", relative)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(modules.Path, "home", lambda: tmp_path)
    assert modules._directory() == tmp_path / ".cache" / "antagonist"


@pytest.mark.compiles
def test_without_a_home_the_readable_step_answers(monkeypatch):
    def nowhere():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("LOCALAPPDATA", raising=False)
    monkeypatch.setattr(modules.Path, "home", nowhere)
    modules.imported.cache_clear()
    with pytest.warns(SlowStep, match="no directory to keep compiled code in"):
        assert TrackingMPC(Plant(), N=12).implementation == "readable"


# --- beside -----------------------------------------------------------------------------------------------------------


@pytest.mark.compiles
def test_who_does_not_wait_gets_the_readable_step_and_another_process_compiles(caches, monkeypatch):
    begun = []
    monkeypatch.setattr(beside, "begin", lambda *arguments: begun.append(arguments) or True)
    plant = Plant()
    with pytest.warns(CompilingBeside, match="another process compiles the controller's step") as said:
        mpc = TrackingMPC(plant, N=12, wait=False)
    assert (len(said), mpc.implementation) == (1, "readable")
    [(name, directory, *work)] = begun
    assert (directory / f"{name}.py").exists()
    assert work == [compile_step, plant, 0.01]
    modules.imported.cache_clear()
    monkeypatch.undo()
    x, compiled = plant.at_rest(0.0, 7.6), TrackingMPC(plant, N=12)
    for k in range(20):  # with limits that bind
        reference = 0.5 * np.sin(0.3 * k), 7.6 + 0.2 * np.cos(0.3 * k)
        plan = mpc.step(x, *reference)
        np.testing.assert_allclose(plan.u, compiled.step(x, *reference).u, atol=1e-6 * BAR)
        x = plan.x[1]


@pytest.mark.compiles
def test_what_is_compiled_is_taken_by_who_does_not_wait():
    TrackingMPC(Plant(), N=12)
    assert TrackingMPC(Plant(), N=12, wait=False).implementation == "compiled"


@pytest.mark.compiles
def test_where_no_process_can_compile_beside_all_wait(caches, monkeypatch):
    monkeypatch.setattr(beside, "begin", lambda *_: False)
    monkeypatch.setattr("mpc.tracking.compiled.factory.CompiledQPStep", Loaded)
    monkeypatch.setattr("mpc.tracking.compiled.factory.CompiledFeedForward", lambda plant, readable: readable)
    mpc = TrackingMPC(Plant(), N=12, wait=False)
    assert mpc.implementation == "loaded"


class Loaded(ReadableQPStep):
    """A step that is not there when nothing may be compiled, and takes no time to compile else."""

    implementation = "loaded"

    def __init__(self, plant, problem):
        beside.check_may_compile("step")
        super().__init__(problem, Predictor(Plant(), 0.01, 12))


@pytest.mark.slow
def test_another_process_compiles_what_a_controller_needs(tmp_path):
    TrackingMPC(Plant())  # here it is compiled, and found there
    assert beside.begin("work", tmp_path, compile_step, Plant(), 0.01)
    assert beside._STARTED[-1].wait(timeout=120) == 0
    assert not [*tmp_path.iterdir()]


# --- what is kept on disk ---------------------------------------------------------------------------------------------


@pytest.fixture
def caches(monkeypatch, tmp_path):
    """An empty directory for modules, as long as the test runs."""
    monkeypatch.setattr(modules, "_directory", lambda: tmp_path)
    modules.imported.cache_clear()
    yield tmp_path
    modules.imported.cache_clear()


@pytest.mark.compiles
def test_a_module_that_was_cut_off_is_written_again(caches):
    assert modules.imported("value = 12\n").value == 12
    [file] = caches.glob("*.py")
    for rest in (b"", b"value = 1", b"\xff("):
        file.write_bytes(rest)
        modules.imported.cache_clear()
        assert modules.imported("value = 12\n").value == 12
        assert file.read_text(encoding="utf-8") == "value = 12\n"


@pytest.mark.compiles
def test_nothing_is_left_of_a_module_that_could_not_be_written(caches, monkeypatch):
    def full(new, file):
        raise OSError("no space left on the device")

    monkeypatch.setattr(atomic.os, "replace", full)
    with pytest.raises(OSError, match="no space left"):
        modules.imported("value = 12\n")
    assert not [*caches.iterdir()]


@pytest.mark.compiles
def test_nothing_is_left_of_a_module_that_fails(caches):
    before = set(sys.modules)
    with pytest.raises(ZeroDivisionError):
        modules.imported("1 / 0\n")
    assert set(sys.modules) == before


@pytest.mark.compiles
def test_no_module_of_the_package_itself_keeps_compiled_code():
    module.compiled_plant(Plant(), 0.01)
    assert module.solve_module().settle.stats.cache_path is not None  # where numba says so
    for name in (
        "mpc.tracking.compiled.sample.stages",
        "mpc.observer.compiled.sample",
    ):  # other tests may have imported them
        import_module(name)
    functions = [
        value
        for name, loaded in sys.modules.items()
        if name.startswith("mpc.")
        for value in vars(loaded).values()
        if hasattr(value, "py_func")
    ]
    assert len(functions) > 20
    assert [f for f in functions if f.stats.cache_path is not None] == []
    for function in functions:
        assert Path(function.py_func.__code__.co_filename).read_text(encoding="utf-8") in modules._surroundings()


CHOOSE = """
import numpy as np
from mpc.codegen import modules
chosen = modules.imported('''
import numpy as np
from mpc.codegen.jit import compiled
from mpc.tracking.compiled.structured_qp.stage import choose

@compiled
def chosen(v):
    feedback, D = np.zeros((1, 2, 7)), np.array([[1.0, 0.0, 1.0]])
    held, inverse = np.array([[-1, 0]], np.int8), np.zeros((1, 3))
    choose(np.zeros((1, 2, 6)), np.ones((1, 2)), D, np.zeros((1, 2)), v.reshape(1, 2), held, 0, inverse, feedback)
    return feedback[0, 0, 6]
''').chosen
print(chosen(np.array([3.0, 0.0])), sum(chosen.stats.cache_hits.values()), modules.__file__)
"""


@pytest.mark.slow
def test_an_edit_in_what_compiled_code_calls_is_seen(tmp_path):
    for package in ("allocator", "mpc"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    home = dict.fromkeys(("HOME", "LOCALAPPDATA", "XDG_CACHE_HOME"), str(tmp_path / "caches"))
    places = {"folder": tmp_path, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": "", **home}
    edited = tmp_path / "mpc" / "tracking" / "compiled" / "structured_qp" / "stage.py"
    value, hits, file = python(CHOOSE, **places).split()
    assert Path(file) == tmp_path / "mpc" / "codegen" / "modules.py"
    assert (float(value), int(hits)) == (3.0, 0)
    assert python(CHOOSE, **places).split()[:2] == ["3.0", "1"]  # it was kept
    before = edited.read_text(encoding="utf-8")
    edited.write_text(before.replace("else v[k, 0]", "else v[k, 0] + 1.0"), encoding="utf-8")
    assert python(CHOOSE, **places).split()[:2] == ["4.0", "0"]


# --- translation ------------------------------------------------------------------------------------------------------


def evaluated(function, *values):
    """The outputs (n,) of the CasADi `function`, by CasADi and by its translation."""
    source, names = translated("law", function), {}
    exec(printer.IMPORTS + source.text, names)
    given = [ca.DM(function.sparsity_in(i), np.ravel(v)) for i, v in enumerate(values)]
    wanted = np.concatenate([v.nonzeros() for v in function.call(given)])
    return wanted, np.array(names["law"](*np.concatenate([np.ravel(v) for v in values]).tolist(), source.c))


def test_every_joint_s_law_is_translated_to_the_last_digits(joint):
    plant = Plant(joint=joint, gravity_torque=0.8, lag=(0.1, 0.07))
    rng = np.random.default_rng(0)  # its own draws, whichever tests ran before
    left, right = joint.angle_range
    for name, function in module._functions(plant).items():
        for _ in range(5):
            x = np.array([rng.uniform(left, right), rng.normal(), *rng.uniform(1 * BAR, 4 * BAR, 2)])
            u, d = rng.uniform(1, 4, 2), rng.normal()
            S = np.random.default_rng(1).normal(size=function.nnz_in(1 % function.n_in()))
            given = {1: (x,), 3: (x, u, d), 4: (x, S, u, d)}[function.n_in()]
            wanted, found = evaluated(function, *((x[0],) if name == "coefficients" else given))
            np.testing.assert_allclose(found, wanted, rtol=1e-13, atol=1e-13)


@pytest.mark.slow
def test_laws_too_long_to_compile_are_left_to_the_readable_step(joints):
    angles = np.linspace(-1.5, 1.5, 120)
    table = Table(0.40, angles, 0.13 + 0.04 * np.sin(angles), 0.13 - 0.04 * np.sin(angles))
    plant = Plant(joint=replace(joints["sarosi-table"], geometry=table))
    with pytest.warns(SlowStep, match=r"forty times as long: the law's function .* operations, more than"):
        mpc = TrackingMPC(plant, N=4)
    assert mpc.implementation == "readable"


@pytest.mark.compiles
def test_what_the_compiler_fails_at_is_left_to_the_readable_step(monkeypatch):
    wrong = {**PYTHON.operations, "OP_SIN": "float({0} > 0.0)"}  # which numba does not take
    monkeypatch.setattr(printer, "PYTHON", replace(PYTHON, operations=wrong))
    with pytest.warns(SlowStep, match="forty times as long: Failed in nopython mode") as said:
        mpc = TrackingMPC(Plant(gravity_torque=0.5), N=4)
    assert (mpc.implementation, len(said), said[0].filename) == ("readable", 1, __file__)
    assert "\n" not in str(said[0].message)
    assert mpc.step(mpc.plant.at_rest(0.0, 7.6), 0.1, 7.8).status is PlanStatus.OPTIMAL


@pytest.mark.compiles
def test_joints_that_differ_in_their_numbers_share_the_compiled_code():
    one, two = (module.compiled_plant(Plant(inertia=J, damping=b, lag=b), 0.01) for J, b in ((0.05, 0.1), (0.07, 0.13)))
    assert one.step is two.step
    assert (one.c != two.c).any()
