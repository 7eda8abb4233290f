"""The firmware of a board as a person meets it: what is made, for whom it compiles, and what is refused."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator.errors import InvalidInput, MissingBackend
from allocator.units import BAR
from mpc import Arm, Plant, RealPlant, TrackingMPC
from mpc.bench.devices import serial_protocol as protocol
from mpc.cli import app
from mpc.export.serial.firmware import Safety, export_board, protocol_header
from mpc.model.faults import StuckValve

from ...rigs import toolchain as tools
from ...rigs.needs import needs

pytestmark = pytest.mark.tools

COMPILERS = {"this PC": ("gcc", "-O2"), "a Cortex-M4F": (tools.ARM_GCC, *tools.CORTEX_M4F)}


@pytest.fixture(scope="module")
def controller():
    return TrackingMPC(Plant(), N=3)


@pytest.fixture(scope="module")
def arm_s_controller():
    return TrackingMPC(Arm.machine("arm26"), N=3, compiled=False)


def objects(directory, sources, compiler, *flags):
    """The sources compiled without a warning, and without a call of the heap."""
    made = []
    for source in sources:
        made.append(directory / f"{source.parent.name}-{source.stem}.o")
        command = [compiler, *tools.STRICT, "-Iserial", "-Isimulated", *flags, "-c", source, "-o", made[-1]]
        done = subprocess.run(list(map(str, command)), cwd=directory, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")
    return made


@pytest.mark.parametrize("compiler", [pytest.param(c, id=name, marks=needs(c[0])) for name, c in COMPILERS.items()])
@pytest.mark.parametrize(
    ("variant", "precision"), [("terminal", "double"), ("controller", "double"), ("controller", "single")]
)
@pytest.mark.parametrize("joints", [1, 2])
def test_the_firmware_compiles_without_a_warning_and_without_a_heap(
    compiler, joints, variant, precision, controller, arm_s_controller, tmp_path
):
    of_machine = controller if joints == 1 else arm_s_controller
    given = of_machine if variant == "controller" else None
    made = export_board(tmp_path / "c", process=of_machine.plant, controller=given, precision=precision)
    sources = sorted((made / "serial").glob("*.c"))
    assert {source.stem for source in sources} == {"board", "frames", "main", "port"} | ({"follow"} if given else set())
    names = subprocess.run(["nm", *objects(made, sources, *compiler)], capture_output=True, text=True).stdout
    assert "ant_board_poll" in names
    assert not {"malloc", "calloc", "realloc", "free"} & set(names.split())
    if compiler[0] == "gcc":
        objects(made, sorted((made / "simulated").glob("*.c")), *compiler)
    elif not given:
        sizes = [tools.size_of(path) for path in made.glob("serial-*.o")]
        assert sum(size.code for size in sizes) < 4 * 1024
        assert sum(size.memory for size in sizes) < 1024


@pytest.mark.parametrize("sizes", [protocol.JOINT, protocol.Sizes(2, 6), protocol.Sizes(3, 7)])
def test_the_header_has_every_constant_of_the_table_that_the_host_runs_by(sizes, tmp_path):
    (tmp_path / "protocol.h").write_text(protocol_header(sizes))
    lines = [f'_Static_assert(ANT_KIND_{kind.name} == {int(kind)}, "");' for kind in protocol.Kind]
    lines += [f'_Static_assert(ANT_STATE_{state.name} == {int(state)}, "");' for state in protocol.State]
    for kind, fields in protocol.LAYOUTS.items():
        at = np.cumsum([0, *(protocol.packing((field,), sizes).size for field in fields)])
        names = [field.name.upper() for field in fields] + ["BYTES"]
        lines += [f'_Static_assert(ANT_{kind.name}_{name} == {a}, "");' for name, a in zip(names, at, strict=True)]
    (tmp_path / "check.c").write_text('#include "protocol.h"\n' + "\n".join(lines) + "\n")
    done = subprocess.run(["gcc", "-fsyntax-only", "-Wall", "check.c"], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    "options",
    [
        ["--variant", "terminal"],
        ["--variant", "terminal", "--machine", "arm26"],
        pytest.param(["--machine", "arm26", "--horizon", "3"], marks=pytest.mark.slow),
    ],
)
def test_one_command_exports_a_board_and_the_lines_of_its_readme_compile_it(options, tmp_path):
    options += ["--watchdog", "0.5", "--fall", "inf"]
    result = CliRunner().invoke(app, ["export", "firmware", "--out", str(tmp_path / "c"), *options])
    assert result.exit_code == 0, result.output
    assert "#define ANT_WATCHDOG_US 500000u" in (tmp_path / "c" / "serial" / "config.h").read_text()
    readme = (tmp_path / "c" / "serial" / "README.md").read_text().splitlines()
    assert "all pressures fall to the least at once" in " ".join(readme)
    lines = [line.strip().replace("cc ", "gcc ", 1) for line in readme if line.startswith("    cc ")]
    assert len(lines) == 2
    for line in lines:
        subprocess.run(line.replace("-O2", "-Wall -Werror"), shell=True, cwd=tmp_path / "c", check=True)
    assert (tmp_path / "c" / "simulated_board").exists()


def test_what_cannot_be_exported_is_refused_and_nothing_is_written(tmp_path, controller):
    faulty = replace(RealPlant(), faults=(StuckValve(0.0, 1.0, 1),))
    pushed = RealPlant(torque_profile=((1.0, 2.0),))
    for arguments, words in (
        ({"process": faulty}, "faults"),
        ({"process": pushed}, "torque_profile"),
        ({"precision": "half"}, "'half'"),
        ({"controller": controller, "safety": Safety(0.02)}, "3 samples of 0.01 s"),
        ({"controller": replace(controller, budget=0.005)}, "no clock"),
        (
            {"controller": controller, "process": Arm.machine("arm26")},
            "n = 2 and m = 6, the controller's machine n = 1",
        ),
        ({"controller": "mpc"}, "controller = 'mpc' has to be a TrackingMPC"),
        ({"process": 5.0}, "5.0 is no machine: give a Plant, an Arm"),
        ({"process": Plant(), "x0": [0.1, 0.0, np.nan, 1e5]}, "x0"),
        ({"process": Plant(), "x0": [0.1, 0.0]}, "x0"),
        ({"process": Plant(), "x0": [30.0, 0.0, 1e5, 1e5]}, "angles of x0: .* if degrees were meant"),
        ({"process": Plant(), "x0": [0.1, 0.0, 3.0, 3.0]}, "pressures of x0: .* if bar was meant"),
    ):
        with pytest.raises((InvalidInput, MissingBackend), match=words):
            export_board(tmp_path / "c", **arguments)
    for watchdog, fall in ((0.0, BAR), (np.nan, BAR), (0.2, -1.0), (0.2, 1.0), (0.2, np.nan)):
        with pytest.raises(InvalidInput, match=r"watchdog|fall"):
            Safety(watchdog, fall)
    for options, error in (
        (["--variant", "clever"], MissingBackend),
        (["--variant", "terminal", "--errors", "u=1"], InvalidInput),
    ):
        refused = CliRunner().invoke(app, ["export", "firmware", "--out", str(tmp_path / "c"), *options])
        assert isinstance(refused.exception, error)
    assert not list(tmp_path.iterdir())
