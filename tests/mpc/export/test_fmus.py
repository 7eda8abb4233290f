"""FMUs of plants and controllers do what Python does, and say what they cannot do."""

import ctypes
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace

import fmpy
import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from typer.testing import CliRunner

from allocator import AntagonistJoint, Lever, errors, report_joint
from allocator.errors import CannotWrite, InvalidInput, MissingPackage
from allocator.muscles.catalogue import SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG
from mpc import Arm, KalmanObserver, Plant, RealPlant, TrackingMPC, Weights, sine
from mpc.cli import app
from mpc.export.building import compiler
from mpc.export.fmu import PLATFORMS, export_controller_fmu, export_plant_fmu, this_machine
from mpc.model.faults import StuckValve
from mpc.model.friction.dahl import Friction
from mpc.model.real import RealArm
from mpc.tracking.preview import BadNumbers

from ...rigs import toolchain as tools
from ...rigs.fmus import Stepped, names
from ...rigs.needs import needs
from ...rigs.replay import record

pytestmark = [
    pytest.mark.tools,
    needs("gcc"),
]

SPAN = 5 * BAR
SCALE = np.array([1.0, 10.0, SPAN, SPAN])
STATES = ("theta", "omega", "P1", "P2")
LEVER = AntagonistJoint(
    Lever(rest_length=0.40, anchor=0.30, lever=0.03, offset=0.0435),
    SAROSI_DMSP_20_400N,
    SAROSI_DMSP_20_200N,
    angle_limits=(-80 * DEG, 80 * DEG),
)
PLANTS = {
    "nominal": (Plant(), 0.01),
    "all effects": (RealPlant.standard(), 0.01),
    "a dead time of two and a half samples, Dahl's friction, a lever": (
        RealPlant(Plant(LEVER, lag=(0.08, 0.11)), friction=Friction(0.1, 0.2), dead_time=0.025, flow=4 * BAR),
        0.01,
    ),
    "gas, every 3 ms": (
        RealPlant.standard(nominal=Plant(report_joint(SAROSI_DMSP_20_400N), lag=0.12, gas=True)),
        0.003,
    ),
}


ARM = RealArm(
    replace(Arm.machine("arm26"), gas=True),
    friction=(Friction(0.1, 0.2), Friction(0.2)),
    force_gains=(1.1, 0.9, 1.0, 1.0, 1.2, 0.8),
    dead_time=0.025,
    encoder=0.02 * DEG,
    mass=1.2,
)


def commands(n, seed, joints=1, muscles=2):
    rng = np.random.default_rng(seed)
    rows = np.hstack([rng.uniform(1 * BAR, 4 * BAR, (n, muscles)), rng.normal(size=(n, joints))])
    return np.repeat(rows, 20, axis=0)


@pytest.fixture(scope="module")
def standard(tmp_path_factory):
    return export_plant_fmu(tmp_path_factory.mktemp("fmu") / "plant.fmu", PLANTS["all effects"][0])


@pytest.mark.parametrize(("process", "dt"), PLANTS.values(), ids=PLANTS)
def test_a_plant_s_fmu_is_valid_and_moves_as_in_python(process, dt, tmp_path):
    """`python -m benchmarks.fmus` takes 10 000 steps."""
    x0 = process.at_rest(0.1, 6.5)
    path = export_plant_fmu(tmp_path / "plant.fmu", process, dt, x0=x0)
    assert validate_fmu(str(path)) == []
    experiment, real = process.begin(dt, x0, 0), RealPlant(process) if isinstance(process, Plant) else process
    if isinstance(process, Plant):
        experiment = real.begin(dt, x0, 0)  # which also takes a torque
    with Stepped(path, tmp_path / "fmu", dt) as fmu:
        np.testing.assert_array_equal(fmu.get(*STATES), x0)
        for u1, u2, d in commands(20, seed=1):
            fmu.set(u1=u1, u2=u2, d=d)
            fmu.step()
            experiment.advance(np.array([u1, u2]), d)
            assert np.abs((np.array(fmu.get(*STATES)) - experiment.x) / SCALE).max() < 1e-12
        x = experiment.x
        K, T, F1, F2, read = fmu.get("K", "T", "F1", "F2", "theta_measured")
    assert K == pytest.approx(float(real.stiffness(x)), rel=1e-9)
    assert T == pytest.approx(float(real.torque(x)), rel=1e-9)
    assert (F1, F2) == pytest.approx(tuple(map(float, real.forces(x))), rel=1e-9)
    assert read == experiment.measure()[0]


def test_the_fmu_of_an_arm_s_plant_is_valid_and_moves_as_in_python(tmp_path):
    n, m = ARM.nominal.n, ARM.nominal.m
    (states, valves, torques), x0 = names(n, m), ARM.nominal.at_rest(ARM.nominal.middle, np.diag([8.0, 6.0]))
    path = export_plant_fmu(tmp_path / "plant.fmu", ARM, x0=x0)
    assert validate_fmu(str(path)) == []
    experiment, scale = ARM.begin(0.01, x0, 0), np.repeat([1.0, 10.0, SPAN], [n, n, m])
    with Stepped(path, tmp_path / "fmu", 0.01) as fmu:
        np.testing.assert_array_equal(fmu.get(*states), x0)
        for row in commands(10, 5, n, m):
            fmu.set(**dict(zip([*valves, *torques], row, strict=True)))
            fmu.step()
            experiment.advance(row[:m], row[m:])
            assert np.abs((np.array(fmu.get(*states)) - experiment.x) / scale).max() < 1e-10
        K, F = ARM.along(experiment.x[None])
        q, P = experiment.x[:n], experiment.x[2 * n :]
        np.testing.assert_allclose(fmu.get("K11", "K12", "K22"), K[0][np.triu_indices(n)], rtol=1e-9)
        np.testing.assert_allclose(fmu.get(*(f"F{j + 1}" for j in range(m))), F[0], rtol=1e-9)
        arms = ARM.nominal.mechanism.routes.at(q).arm
        np.testing.assert_allclose(fmu.get("T1", "T2"), arms.T @ F[0], rtol=1e-9)
        np.testing.assert_array_equal(fmu.get("theta1_measured", "theta2_measured"), experiment.measure()[:n])
    assert P.min() > 0


def test_a_nominal_plant_s_fmu_is_the_plant_that_simulate_takes(tmp_path):
    plant = Plant()
    x0 = plant.at_rest(0.1, 6.5)
    experiment = plant.begin(0.01, x0, 0)
    path = export_plant_fmu(tmp_path / "plant.fmu", plant, x0=x0)
    with Stepped(path, tmp_path / "fmu", 0.01) as fmu:
        for u1, u2, _ in commands(10, seed=2):
            fmu.set(u1=u1, u2=u2)
            fmu.step()
            experiment.advance(np.array([u1, u2]))
            assert np.abs((np.array(fmu.get(*STATES)) - experiment.x) / SCALE).max() < 1e-12


def test_fmpy_simulates_a_plant_from_another_start(standard):
    start = {"theta_start": 0.3, "P1_start": 3 * BAR, "P2_start": 2 * BAR, "u1": 3 * BAR, "u2": 2 * BAR}
    done = fmpy.simulate_fmu(str(standard), stop_time=0.5, output_interval=0.05, start_values=start)
    assert done["theta"][0] == 0.3
    experiment = PLANTS["all effects"][0].begin(0.01, np.array([0.3, 0.0, 3 * BAR, 2 * BAR]), 0)
    for _ in range(50):
        experiment.advance(np.array([3 * BAR, 2 * BAR]))
    assert done["theta"][-1] == pytest.approx(experiment.x[0], abs=1e-12)


def test_an_fmu_goes_back_to_a_state_that_was_kept_as_bytes_too(standard, tmp_path):
    inputs = commands(3, seed=3)
    with Stepped(standard, tmp_path / "fmu", 0.01) as fmu:

        def run():
            for u1, u2, d in inputs:
                fmu.set(u1=u1, u2=u2, d=d)
                fmu.step()
            return fmu.get(*STATES)

        run()
        kept, t = fmu.fmu.getFMUState(), fmu.t
        as_bytes = fmu.fmu.serializeFMUState(kept)
        first = run()
        fmu.fmu.setFMUState(kept)
        fmu.t = t
        assert run() == first
        fmu.fmu.setFMUState(fmu.fmu.deserializeFMUState(as_bytes))
        fmu.t = t
        assert run() == first
        fmu.fmu.freeFMUState(kept)


def test_what_an_fmu_cannot_do_it_says(standard, tmp_path):
    with Stepped(standard, tmp_path / "fmu", 0.01) as fmu:
        for wrong, words in (
            (lambda: fmu.fmu.doStep(0.0, 0.015), "no multiple of the sample time of 0.01 s"),
            (lambda: fmu.fmu.doStep(1.0, 0.01), "a step from 1 s on, when it is 0 s"),
            (lambda: fmu.fmu.doStep(0.0, np.inf), "is longer than 1e+06 samples"),
            (lambda: fmu.fmu.doStep(0.0, np.nan), "is longer than 1e+06 samples"),
            (lambda: fmu.fmu.doStep(0.0, 1e300), "is longer than 1e+06 samples"),
            (lambda: fmu.fmu.doStep(0.0, -0.01), "no multiple of the sample time of 0.01 s"),
            (lambda: fmu.set(u1=np.nan), "has to be finite, not nan"),
            (lambda: fmu.set(d=-np.inf), "has to be finite, not -inf"),
            (lambda: fmu.set(theta=0.0), "cannot be set now"),
            (lambda: fmu.set(theta_start=0.0), "cannot be set now"),
            (lambda: fmu.fmu.getFloat64([99]), "no Float64 variable with the reference 99"),
            (lambda: fmu.fmu.getFloat64([1, 2], nValues=3), "have 2 values, not 3"),
            (lambda: fmu.fmu.getInt32([1]), "no Int32 variable"),
            (lambda: fmu.fmu.getBoolean([1]), "fmi3GetBoolean is not for this FMU"),
            (fmu.fmu.exitInitializationMode, "not for this phase"),
        ):
            with pytest.raises(Exception, match=r"fmi3Error|failed"):
                wrong()
            assert words in str(fmu.complaints[-1])
        before = fmu.get(*STATES)
        fmu.step(5)  # and goes on
        assert fmu.get("time") == [0.05]
        assert fmu.get(*STATES) != before


def test_a_step_that_leads_out_of_the_numbers_is_not_taken_and_the_fmu_goes_on(standard, tmp_path):
    """A pressure of 1e300 Pa is a number, and its force is none."""
    with Stepped(standard, tmp_path / "fmu", 0.01) as fmu:
        before = fmu.get("time", *STATES)
        fmu.set(u1=1e300, d=1e300)
        with pytest.raises(Exception, match=r"fmi3Error|failed"):
            fmu.step(100)
        assert "lead out of the numbers" in str(fmu.complaints[-1])
        assert fmu.get("time", *STATES) == before
        fmu.t = 0.0
        fmu.set(u1=2 * BAR, d=0.0)
        fmu.step(100)
        assert np.isfinite(fmu.get(*STATES)).all()


def test_states_that_were_damaged_and_those_of_other_fmus_are_refused(standard, tmp_path):
    other = export_plant_fmu(tmp_path / "other.fmu", Plant())
    with Stepped(standard, tmp_path / "fmu", 0.01) as fmu, Stepped(other, tmp_path / "other", 0.01) as stranger:
        fmu.step(3)
        kept = fmu.fmu.getFMUState()
        good, reached = bytes(fmu.fmu.serializeFMUState(kept)), fmu.get("time", *STATES)
        flipped = bytearray(good)
        flipped[len(good) // 2] ^= 1
        strange = bytes(stranger.fmu.serializeFMUState(stranger.fmu.getFMUState()))[: len(good)].ljust(len(good), b"\0")
        for wrong in (bytes(len(good)), b"\xff" * len(good), bytes(flipped), strange):
            with pytest.raises(Exception, match=r"fmi3Error|failed"):
                fmu.fmu.deserializeFMUState(wrong)
            assert "no state of this FMU, or damaged" in str(fmu.complaints[-1])
        ctypes.memset(kept, 0, len(good))
        with pytest.raises(Exception, match=r"fmi3Error|failed"):
            fmu.fmu.setFMUState(kept)
        assert "no state of this FMU, or it was changed" in str(fmu.complaints[-1])
        assert fmu.get("time", *STATES) == reached
        fmu.fmu.freeFMUState(kept)


def test_fmus_claim_no_variable_steps(standard):
    """Steps have to be multiples of the sample time."""
    assert fmpy.read_model_description(str(standard)).coSimulation.canHandleVariableCommunicationStepSize is False


@pytest.mark.slow
def test_no_command_is_negative_even_where_a_gauge_reads_less_than_nothing(tmp_path):
    """Before the first step, in it and after it; Python alike."""
    plant = Plant()
    controller = TrackingMPC(plant, N=3, weights=Weights.calm())
    observer = KalmanObserver(plant, controller.dt)
    path = export_controller_fmu(tmp_path / "controller.fmu", controller, observer)
    low, high = -0.03 * BAR, 5.02 * BAR
    for P1, P2 in ((low, low), (low, high), (np.nan, low)):
        with Stepped(path, tmp_path / "fmu", controller.dt, {"theta": 0.0, "P1": P1, "P2": P2}) as fmu:
            sent = [fmu.get("u1", "u2")]
            for _ in range(3):
                fmu.step()
                sent.append(fmu.get("u1", "u2"))
        assert np.min(sent) >= 0
        assert np.max(sent) <= high  # from beyond the supply commands return at the slew limit
    fresh = TrackingMPC(plant, N=3, weights=Weights.calm())
    with pytest.warns(BadNumbers, match="the pressures are held"):
        assert fresh.step(np.array([0.0, 0.0, low, low]), np.nan, 5.0).u[0].min() >= 0


@pytest.mark.slow
def test_a_controller_s_fmu_commands_what_python_commands(tmp_path):
    real = RealPlant.standard()
    told = {"compensation": real.known()}
    controller = TrackingMPC(real.nominal, N=10, weights=Weights.calm(), **told)
    observer = KalmanObserver(real.nominal, controller.dt, **told)
    done = record(real, controller, observer, sine(K=5.5, duration=4.5))
    path = export_controller_fmu(tmp_path / "controller.fmu", controller, observer)
    assert validate_fmu(str(path)) == []
    ahead = controller.ahead + 1

    with Stepped(path, tmp_path / "fmu", controller.dt) as fmu:

        def answer(sample):
            theta, P1, P2 = sample[:3]
            fmu.set(theta=theta, P1=P1, P2=P2, theta_ref=sample[4 : 4 + ahead], K_ref=sample[4 + ahead :])
            fmu.step()
            return fmu.get("u1", "u2", "status", "rung")

        for k, (sample, wanted) in enumerate(zip(done.samples, done.answers, strict=True)):
            got = answer(sample)
            assert np.abs(np.array(got[:2]) - wanted[:2]).max() < 1e-12 * SPAN
            assert got[2:] == wanted[2:4].tolist()
            if k == 200:
                kept, t = fmu.fmu.getFMUState(), fmu.t
        fmu.fmu.setFMUState(kept)
        fmu.t = t
        for sample, wanted in zip(done.samples[201:240], done.answers[201:240], strict=True):
            assert np.abs(np.array(answer(sample)[:2]) - wanted[:2]).max() < 1e-12 * SPAN


@pytest.mark.slow
def test_the_sources_in_an_fmu_are_complete_and_compile_without_a_warning(tmp_path):
    path = export_plant_fmu(tmp_path / "plant.fmu", RealPlant.standard(), platforms=())
    with zipfile.ZipFile(path) as archive:
        assert not [name for name in archive.namelist() if name.startswith("binaries")]
        archive.extractall(tmp_path / "fmu")
    sources = tmp_path / "fmu" / "sources"
    command = ["gcc", *tools.STRICT, "-fsyntax-only", *map(str, sorted((sources / "src").glob("*.c")))]
    done = subprocess.run(command, cwd=sources, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    if shutil.which("cmake"):
        build = "import sys, fmpy.build; fmpy.build.build_platform_binary(sys.argv[1])"
        subprocess.run([sys.executable, "-c", build, str(tmp_path / "fmu")], check=True, capture_output=True)
        assert list((tmp_path / "fmu" / "binaries").rglob("antagonist_plant.*"))


ZIG = """
import os, sys
command, target, *arguments = sys.argv[1], sys.argv[sys.argv.index("-target") + 1], *sys.argv
assert command == "cc" and all(map(os.path.exists, (name for name in arguments if name.endswith(".c"))))
open(sys.argv[sys.argv.index("-o") + 1], "w").write(target)
"""


@pytest.fixture
def zig(tmp_path, monkeypatch):
    """Stand-in for the package ziglang, 100 MB, whose libraries contain the name of their target."""
    package = tmp_path / "packages" / "ziglang"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "__main__.py").write_text(ZIG)
    monkeypatch.syspath_prepend(package.parent)
    monkeypatch.setenv("PYTHONPATH", str(package.parent))
    monkeypatch.delitem(sys.modules, "ziglang", raising=False)
    yield
    sys.modules.pop("ziglang", None)


def binaries(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist() if name.startswith("binaries/")}


def test_an_fmu_has_the_binaries_that_were_asked_for(standard, zig, tmp_path):
    process, own = PLANTS["all effects"][0], this_machine()
    path = export_plant_fmu(tmp_path / "plant.fmu", process, platforms=(*PLATFORMS, own))
    found = binaries(path)
    library = f"binaries/{own}/antagonist_plant.so"
    assert found.pop(library) == binaries(standard)[library]
    wanted = {
        "x86_64-linux": ("x86_64-linux-gnu.2.17", "so"),
        "aarch64-linux": ("aarch64-linux-gnu.2.17", "so"),
        "x86_64-windows": ("x86_64-windows-gnu", "dll"),
        "x86_64-darwin": ("x86_64-macos", "dylib"),
        "aarch64-darwin": ("aarch64-macos", "dylib"),
    }
    assert found == {
        f"binaries/{name}/antagonist_plant.{suffix}": target.encode()
        for name, (target, suffix) in wanted.items()
        if name != own
    }
    assert validate_fmu(str(path)) == []


def test_other_platforms_need_ziglang_and_known_names(tmp_path, monkeypatch):
    monkeypatch.delitem(sys.modules, "ziglang", raising=False)
    with monkeypatch.context() as without:
        without.setattr(sys, "meta_path", [one for one in sys.meta_path if isinstance(one, errors._NameMissing)])
        with pytest.raises(MissingPackage, match=r"pip install 'antagonist\[fmu\]'"):
            compiler("x86_64-windows-gnu")
    for wrong in (("x86_64-amiga",), "x86_64-linux"):
        with pytest.raises(InvalidInput, match=r"platforms = .* x86_64-windows"):
            export_plant_fmu(tmp_path / "plant.fmu", Plant(), platforms=wrong)
    assert not list(tmp_path.iterdir())


def test_the_same_model_makes_the_same_fmu(standard, tmp_path):
    again = export_plant_fmu(tmp_path / "again.fmu", PLANTS["all effects"][0])
    assert again.read_bytes() == standard.read_bytes()


def test_what_cannot_be_an_fmu_is_refused_and_nothing_is_written(tmp_path):
    faulty = replace(RealPlant(), faults=(StuckValve(0.0, 1.0, 1),))
    for arguments, words in (
        (("plant.zip", Plant()), r"has to end in .fmu"),
        (("plant.fmu", faulty), "faults"),
        (("plant.fmu", Plant(), 0.0), "dt"),
    ):
        with pytest.raises(InvalidInput, match=words):
            export_plant_fmu(tmp_path / arguments[0], *arguments[1:])
    with pytest.raises(InvalidInput, match="x0"):
        export_plant_fmu(tmp_path / "plant.fmu", Plant(), x0=[0.0, np.nan, 0.0, 0.0])
    with pytest.raises(InvalidInput, match="no clock"):
        export_controller_fmu(tmp_path / "controller.fmu", TrackingMPC(Plant(), N=3, budget=0.005))
    both, unknown = ["--source-only", "--platforms", "all"], ["--platforms", "x86_64-amiga"]
    for options in (["--precision", "single"], both, unknown):
        refused = CliRunner().invoke(app, ["export", "fmu", "--out", str(tmp_path / "fmus"), *options])
        assert refused.exit_code
    assert not list(tmp_path.iterdir())
    (tmp_path / "plant.fmu").mkdir()
    with pytest.raises(CannotWrite):
        export_plant_fmu(tmp_path / "plant.fmu", Plant())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "wanted"),
    [([], {this_machine()}), (["--source-only"], set()), (["--platforms", "all"], {*PLATFORMS, this_machine()})],
    ids=["this machine's", "sources", "all platforms"],
)
def test_one_command_writes_both(more, wanted, zig, tmp_path):
    given = "--out", str(tmp_path / "fmus"), "--horizon", "3", "--errors", "theta=0.1,rate=0.3"
    result = CliRunner().invoke(app, ["export", "fmu", *given, *more])
    assert result.exit_code == 0, result.output
    assert "written: 2 files" in result.output
    for name in ("plant", "controller"):
        path = tmp_path / "fmus" / f"{name}.fmu"
        assert validate_fmu(str(path)) == []
        assert {library.split("/")[1] for library in binaries(path)} == wanted


@pytest.mark.slow
def test_the_command_writes_plant_and_controller_of_an_arm(tmp_path):
    out = tmp_path / "fmus"
    given = ["--machine", "arm26", "--horizon", "3", "--source-only", "--out", str(out)]
    result = CliRunner().invoke(app, ["export", "fmu", *given])
    assert result.exit_code == 0, result.output
    assert "written: 2 files in" in result.output
    assert {path.name for path in out.iterdir()} == {"controller.fmu", "plant.fmu"}
    assert all(validate_fmu(str(path)) == [] for path in out.iterdir())
    described = read_model_description(str(out / "controller.fmu"))
    rows = {v.name: v.dimensions[0].start for v in described.modelVariables if v.dimensions}
    assert rows == {"theta_ref": 12, "K_ref": 18}  # of 1 + 3 + 2 samples, with a dead time of two
