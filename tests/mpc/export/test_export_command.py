"""`antagonist export` and `mpc.export.export` as a person meets them: what is made, and what is refused."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from allocator import AntagonistError, PrandtlIshlinskii, report_joint, save_machine
from allocator.errors import InvalidInput, MissingBackend
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_LOPEZ_LAAS_ARM
from allocator.units import BAR
from mpc import Compensation, KalmanObserver, Plant, TrackingMPC
from mpc.cli import app, main
from mpc.export import export

from ...rigs import toolchain as tools
from ...rigs.needs import needs

pytestmark = pytest.mark.tools

needs_gcc = needs("gcc")
needs_cmake = needs("gcc", "cmake")
ERRORS = "--errors", "theta=0.1,rate=0.3"  # without them robust weights are searched for, which takes seconds


def invoke(*arguments):
    return CliRunner().invoke(app, ["export", *map(str, arguments)])


def test_a_tuning_is_not_written_over_the_joint_that_it_was_made_from(tmp_path, monkeypatch):
    """By its name, by another spelling of its path, through a symbolic link, and with --force."""
    joint, link = tmp_path / "joint.toml", tmp_path / "link.toml"
    save_machine(report_joint(SAROSI_DMSP_20_400N), joint)
    link.symlink_to(joint)
    text = joint.read_text()
    monkeypatch.chdir(tmp_path)
    for read, out in (("joint.toml", "joint.toml"), (joint, "./joint.toml"), (joint, link), (link, joint)):
        result = invoke("tuning", "--machine", read, "--out", out, "--force", "--horizon", 3)
        assert isinstance(result.exception, InvalidInput), result.output
        assert "is read by this command and cannot be written by it" in str(result.exception)
        assert joint.read_text() == text


@needs_cmake
def test_one_command_exports_one_builds_and_the_demonstration_prints_python_s_numbers(tmp_path):
    out = tmp_path / "new" / "c"
    result = invoke("controller", "--out", out, "--muscle", "sarosi-dmsp-20-400n", *ERRORS)
    assert result.exit_code == 0, result.output
    assert "README.md" in result.output.replace("\n", "")
    subprocess.run(["cmake", "-S", out, "-B", out / "build"], check=True, capture_output=True)
    subprocess.run(["cmake", "--build", out / "build"], check=True, capture_output=True)
    printed = tools.run(out / "build" / "demonstration")
    assert printed in (out / "README.md").read_text()
    assert len(printed.splitlines()) == 19


@needs_gcc
def test_the_plain_compiler_line_of_the_exported_readme_works(tmp_path):
    invoke("controller", "--out", tmp_path / "c", "--alone", "--precision", "single", "--horizon", "5", *ERRORS)
    lines = (tmp_path / "c" / "README.md").read_text().splitlines()
    line = next(line.strip() for line in lines if line.startswith("    cc "))
    subprocess.run(line.replace("cc ", "gcc ", 1), shell=True, cwd=tmp_path / "c", check=True)
    assert len(tools.run(tmp_path / "c" / "demonstration").splitlines()) == 10


@needs_gcc
def test_a_joint_from_a_file_brings_its_friction_into_the_c_code(tmp_path):
    save_machine(replace(report_joint(SAROSI_DMSP_20_400N), friction=0.13), tmp_path / "joint.toml")
    result = invoke("controller", "--out", tmp_path / "c", "--machine", tmp_path / "joint.toml")
    assert result.exit_code == 0, result.output
    model = (tmp_path / "c" / "src" / "model.c").read_text()
    friction = model[model.index("void ant_model_friction(") :]
    assert "0.13" in friction[: friction.index("\n}")]


@needs_gcc
def test_a_plant_s_file_brings_hysteresis_and_dead_time_into_the_c_code(tmp_path):
    operator = PrandtlIshlinskii((0.6, 0.2, 0.2), (0.02, 0.06), base=0.3)
    save_machine(replace(report_joint(SAROSI_DMSP_20_400N), hysteresis=operator), tmp_path / "joint.toml")
    with (tmp_path / "joint.toml").open("a") as file:
        file.write("\n[regulators]\ndead_time = 0.03\n")
    machine = "--machine", tmp_path / "joint.toml"
    result = invoke("controller", "--out", tmp_path / "c", *machine, "--alone", "--horizon", "5", *ERRORS)
    assert result.exit_code == 0, result.output
    assert "hysteresis of the angle with 2 elements, dead time 0.03 s" in result.output
    config = (tmp_path / "c" / "antagonist_config.h").read_text()
    assert all(f"#define ANT_{line}" in config for line in ("SLIPS 1", "ELEMENTS 2", "DELAY 3"))
    printed = tools.run(tools.compiled(tmp_path / "c", Path("main.c"), "demonstration", *tools.QUICK))
    assert printed in (tmp_path / "c" / "README.md").read_text()


@needs_gcc
def test_every_joint_is_either_exported_as_clean_c_or_refused_in_a_sentence(joints, tmp_path):
    exported, refused = [], {}
    for name, joint in joints.items():
        try:
            made = export(tmp_path / name, joint=joint, what="allocate")
        except InvalidInput as refusal:
            refused[name] = str(refusal)
            assert not (tmp_path / name).exists()
        else:
            sources = [str(path) for path in (made / "src").glob("*.c")]
            command = ["gcc", *tools.STRICT, "-fsyntax-only", "main.c", *sources]
            assert subprocess.run(command, cwd=made, capture_output=True).stderr == b""
            exported.append(name)
    assert {"report", "tondu-c-pulley", "sarosi-pulley", "sarosi-lever", "sarosi-table"} <= set(exported)
    assert {"tondu-lever", "tondu-unequal-pulley"} <= set(refused)
    assert all("cannot be exported" in sentence for sentence in refused.values())


def test_the_files_of_the_same_joint_differ_by_precision_in_their_numbers_only(tmp_path):
    for precision in ("double", "single"):
        export(tmp_path / precision, what="allocate", precision=precision)
    names = [{path.relative_to(made) for path in made.rglob("*")} for made in tmp_path.iterdir()]
    assert names[0] == names[1]
    double, single = ((tmp_path / p / "src" / "kernel.c").read_text() for p in ("double", "single"))
    assert re.sub(r"\b(\d[\d.e-]*)f\b", r"\1", single) == double


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"joint": report_joint(TONDU_LOPEZ_LAAS_ARM)}, "TonduLopez2000 .* no closed form"),
        ({"what": "everything"}, "'everything'.*all, allocate, mpc"),
        ({"precision": "half"}, "'half'.*double, single"),
        ({"controller": {}, "joint": report_joint(SAROSI_DMSP_20_400N)}, "not the one"),
        ({"controller": {"budget": 0.005}}, "no clock"),
        ({"controller": {}, "observer": {"dt": 0.02}}, "their dt"),
        ({"controller": {}, "observer": {"compensation": Compensation(dead_band=0.1 * BAR)}}, "their compensation"),
    ],
)
def test_what_cannot_be_exported_is_refused_and_nothing_is_written(arguments, words, tmp_path):
    arguments = dict(arguments)
    if "controller" in arguments:
        arguments["controller"] = TrackingMPC(Plant(), N=5, **arguments["controller"])
    if "observer" in arguments:
        arguments["observer"] = KalmanObserver(Plant(), **{"dt": 0.01, **arguments["observer"]})
    with pytest.raises((InvalidInput, MissingBackend), match=words):
        export(tmp_path / "c", **arguments)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("options", [["--horizon", "0"], ["--horizon", "2"], ["--muscle", "tondu-lopez-laas-arm"]])
def test_the_command_refuses_in_one_sentence_and_writes_nothing(options, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(sys, "argv", ["antagonist", "export", "controller", "--out", str(tmp_path / "c"), *options])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 2
    assert len(capfd.readouterr().err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_directory_that_is_not_empty_is_left_as_it_is(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(AntagonistError, match="not empty"):
        export(tmp_path, what="allocate")
    with pytest.raises(AntagonistError, match="is a file"):
        export(tmp_path / "mine.txt", what="allocate")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    (tmp_path / "empty").mkdir()
    assert (export(tmp_path / "empty", what="allocate") / "antagonist.h").exists()


def test_exporting_leaves_the_controller_s_memory_alone(tmp_path):
    controller = TrackingMPC(Plant(), N=5)
    first = controller.step([0.1, 0.0, 3e5, 2e5], 0.2, 7.6)
    other = TrackingMPC(Plant(), N=5)
    other.step([0.1, 0.0, 3e5, 2e5], 0.2, 7.6)
    export(tmp_path / "c", controller=controller)
    x = first.x[1]
    assert (controller.step(x, 0.2, 7.6).u == other.step(x, 0.2, 7.6).u).all()


@needs_gcc
@pytest.mark.slow
@pytest.mark.parametrize("gas", ["--gas", "--no-gas"])
def test_an_arm_s_controller_is_exported_by_its_name_with_gas_and_without(gas, tmp_path):
    out = tmp_path / "c"
    given = "--machine", "arm26", "--horizon", 3, gas
    result = invoke("controller", *given, "--precision", "single", "--out", out, *ERRORS)
    assert result.exit_code == 0, result.output
    printed = tools.run(tools.compiled(out, Path("main.c"), "demonstration", *tools.QUICK))
    assert len(printed.splitlines()) == 14
    config = (out / "antagonist_config.h").read_text()
    assert "#define ANT_MUSCLES 6" in config
    assert ("#define ANT_GAS" in config) == (gas == "--gas")
    assert invoke("firmware", *given, "--out", tmp_path / "board").exit_code == 0
