"""The motion of a pendulum, integrated here from its own formulas, and the file of its plant."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import BAR, DEG, AntagonistJoint, Pulley
from allocator.files.toml import Table
from allocator.identification import fit_motion
from allocator.joint.gravity import Gravity
from allocator.machine_file import encoder_zero_known_in, save_machine
from allocator.muscles import MODELS
from mpc import Plant
from mpc.cli import app
from mpc.identification.plant import IdentifiedPlant, free_run
from mpc.model.real import RealPlant

AREA, PASSIVE = (2.8e-3, -1.1e-2, 0.0), (-150.0, -900.0)
MUSCLE = MODELS["AffinePolynomial"](area=AREA, passive=PASSIVE)
JOINT = AntagonistJoint(Pulley(0.3, 0.02, 0.12), MUSCLE, MUSCLE, angle_limits=(-1.0, 1.0))
HANGING, INERTIA, DAMPING, LAG, STEP, FINE = Gravity(1.5, 0.3), 0.04, 0.25, 0.1, 0.02, 1e-3


def _torque(theta, P1, P2):
    def force(P, eps):
        return P * (AREA[0] + AREA[1] * eps) + PASSIVE[0] + PASSIVE[1] * eps

    turn = 0.02 * theta / 0.3
    return 0.02 * (force(P1, 0.12 + turn) - force(P2, 0.12 - turn))


def _stiffness(theta, P1, P2, h=1e-5):
    return (_torque(theta - h, P1, P2) - _torque(theta + h, P1, P2)) / (2 * h)


@pytest.fixture(scope="module")
def log():
    """Times, angles and commands: slopes of 8 bar/s between random levels."""
    rng, n = np.random.default_rng(0), 3000
    theta, omega, P, u = 0.1, 0.0, np.full(2, 2.5 * BAR), np.full(2, 2.5 * BAR)
    target, until, rows = u, 0, []
    for k in range(n):
        if k >= until:
            mean, half = rng.uniform(1.8, 3.5), rng.uniform(-0.9, 0.9)
            target, until = np.array([mean + half, mean - half]) * BAR, k + rng.integers(20, 75)
        u = u + np.clip(target - u, -8 * BAR * STEP, 8 * BAR * STEP)
        rows.append((k * STEP, theta, *u))
        for _ in range(round(STEP / FINE)):
            P = P + FINE * (u - P) / LAG
            pull = _torque(theta, *P) - 1.5 * np.sin(theta - 0.3) - DAMPING * omega
            omega += FINE * pull / INERTIA
            theta += FINE * omega
    return np.array(rows).T


@pytest.mark.slow
def test_the_file_of_a_pendulum_has_its_gravity_beside_its_muscles(log, tmp_path):
    t, theta, P1, P2 = log
    fit = fit_motion(t, theta, P1, P2, joint=JOINT, gravity=HANGING, hold_zero=True, gas=False)
    plant = IdentifiedPlant.of(fit)
    assert plant.errors.every < 0.5 * DEG
    assert fit.moving.zero == pytest.approx(0, abs=1e-5)
    plant.save(tmp_path / "plant.toml")
    file, loaded = tomllib.loads((tmp_path / "plant.toml").read_text()), Plant.load(tmp_path / "plant.toml")
    assert (file["plant"]["gravity_torque"], loaded.gravity) == (1.5, HANGING)
    assert loaded.inertia == pytest.approx(INERTIA, rel=0.15)
    rows = slice(100, None, 50)
    true = _stiffness(theta[rows], P1[rows], P2[rows])
    np.testing.assert_allclose(loaded.joint.stiffness(theta[rows], P1[rows], P2[rows]), true, rtol=0.05)


@pytest.mark.slow
def test_the_command_takes_gravity_and_a_held_zero_from_the_joint_s_file(log, tmp_path):
    joint, rows, out = tmp_path / "joint.toml", tmp_path / "log.csv", tmp_path / "plant.toml"
    low = replace(JOINT, pressure_limits=(0.0, 3 * BAR), angle_limits=(-0.01, 0.02))
    save_machine(low, joint, source={"encoder_zero_deg": 2.0, "encoder_zero_std_deg": 0.0})
    with joint.open("a") as file:
        file.write("\n[plant]\ngravity_torque = 1.5\nhanging_angle = 0.3\nslew = 700000.0\n")
    t, theta, P1, P2 = log
    table = np.column_stack([t, theta / DEG + 2.0, P1 / BAR, P2 / BAR])
    np.savetxt(rows, table, delimiter=",", header="time [s],theta [deg],P1 [bar],P2 [bar]", comments="")
    result = CliRunner().invoke(app, ["fit-motion", str(rows), "--machine", str(joint), "--no-gas", "--out", str(out)])
    assert result.exit_code == 0, result.output
    written = tomllib.loads(out.read_text())
    assert written["source"]["encoder_zero_deg"] == pytest.approx(2.0, abs=1e-12)
    assert encoder_zero_known_in(Table.read(out))
    said = " ".join(result.output.split())
    assert "the plant's file widens the range of -0.573° to 1.15° to" in said
    assert f"and the supply of 3 bar to {written['machine']['pressure_limits'][1] / BAR:.3g} bar" in said
    assert written["plant"]["slew"] == 7e5
    assert Plant.load(out).gravity == HANGING


@pytest.mark.slow
def test_the_slew_is_that_of_the_log_s_commands_unless_it_is_known(log):
    t, theta, P1, P2 = log
    fit = fit_motion(t, theta, P1, P2, joint=JOINT, gravity=HANGING, gas=False)
    seen = IdentifiedPlant.of(fit)
    assert seen.seen_slew == pytest.approx(8 * BAR, rel=0.02)
    assert "slew" not in seen.assumed
    known = IdentifiedPlant.of(fit, {"slew": 3e5})
    assert known.seen_slew is None
    assert tomllib.loads(known.text)["plant"]["slew"] == 3e5


def test_a_free_run_rests_on_a_stop_and_leaves_it():
    plant = Plant(JOINT, inertia=INERTIA, damping=DAMPING, gas=False, gravity_torque=1.5, hanging_angle=0.3)
    t = np.arange(0, 4, STEP)
    P1 = np.where(t < 2, 4.5, 2.5) * BAR
    theta = free_run(RealPlant(plant), t, P1, 5 * BAR - P1)
    assert theta.max() == pytest.approx(1.0)
    assert theta[-1] == pytest.approx(float(JOINT.equilibrium(2.5 * BAR, 2.5 * BAR, gravity=HANGING)), abs=0.01)
