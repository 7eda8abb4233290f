"""The plant's file as somebody meets it who has nothing but the file, the log and a textbook."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allocator import BAR, DEG, AntagonistJoint, Lever, PrandtlIshlinskii
from allocator.errors import InvalidFile, InvalidInput
from allocator.identification import fit_motion
from allocator.identification.motion.samples import MotionLog, read_motion_log
from allocator.machine_file import load_joint, save_machine
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Compensation, Plant, RealPlant
from mpc.identification.plant import IdentifiedPlant, replay
from mpc.model.friction.maxwell_slip import MaxwellSlip

from ...rigs.moving_joint import DEAD_TIME, JOINT, LAG, STEP

ROOT = Path(__file__).parents[3]
FINE = 5e-4  # s


def regulated(t, P, regulators):
    """The pressure (m,) [Pa] of a regulator in steps of `FINE`, each command (n,) [Pa] from its dead time on."""
    at = t[0] + FINE * np.arange(round((t[-1] - t[0]) / FINE))
    told = P[np.maximum(np.searchsorted(t, at + FINE / 2 - regulators["dead_time"], side="right") - 1, 0)].tolist()
    up, down = (1 - np.exp(-FINE / regulators[name]) for name in ("lag_up", "lag_down"))
    most, rest, now, out = FINE * regulators.get("flow", np.inf), regulators["dead_band"] / 2, float(P[0]), []
    for command in told:
        out.append(now)
        error = command - now
        error = max(error - rest, 0.0) + min(error + rest, 0.0)
        now += max(min(error * (up if error > 0 else down), most), -most)
    return at, np.array(out)


def simulated(path, t, theta, P1, P2):
    """The angle (n,) [rad] in small steps, from the numbers in the file and the joint's torque."""
    file, joint = tomllib.loads(path.read_text(encoding="utf-8")), load_joint(path, scale_needed=False)
    plant, zero = file["plant"], file["source"]["encoder_zero_deg"] * DEG
    H = PrandtlIshlinskii(**file["hysteresis"]).inverse
    elements = [*zip((-w for w in H.weights[1:]), H.thresholds, strict=True)]  # of H⁻¹ = 1 + Σ κ stop
    (at, one), (_, two) = (regulated(t, P, file["regulators"]) for P in (P1, P2))
    grid, cells = np.linspace(-2, 2, 8001), []
    for of in (joint.torque, joint.stiffness):  # affine in the pressures: Sarosi's law
        base = of(grid, BAR, BAR)
        cells += [base - (by := of(grid, 2 * BAR, BAR) - base) - (more := of(grid, BAR, 2 * BAR) - base), by, more]
    table, last = np.array(cells).T.tolist(), grid.size - 1
    x, speed, stops, out = float(theta[0]) - zero, 0.0, [0.0] * len(elements), []
    half = FINE * plant["damping"] / plant["inertia"] / 2
    one, two = ((P + np.append(P[1:], P[-1])) / 2 / BAR for P in (one, two))  # in the middle of every step
    for p1, p2 in zip(one.tolist(), two.tolist(), strict=True):
        out.append(x)
        widths = [r * (H.base + (1 - H.base) * (p1 + p2) / 5) for _, r in elements]
        x += FINE / 2 * speed
        stops = [max(-r, min(r, e + FINE / 2 * speed)) for r, e in zip(widths, stops, strict=True)]
        cell = min(max(round((x + 2) * 2000), 0), last)
        T0, T1, T2, K0, K1, K2 = table[cell]
        K = K0 + K1 * p1 + K2 * p2
        rubs = sum(k * e for (k, _), e in zip(elements, stops, strict=True))
        torque = T0 + T1 * p1 + T2 * p2 - K * (x + 2 - cell / 2000) - (H.stiffness or K) * rubs
        speed = (speed * (1 - half) + FINE * torque / plant["inertia"]) / (1 + half)
        x += FINE / 2 * speed
        stops = [max(-r, min(r, e + FINE / 2 * speed)) for r, e in zip(widths, stops, strict=True)]
    return np.interp(t, at, out) + zero


def assert_the_file_is_as_it_says(path, t, theta, P1, P2):
    said = tomllib.loads(path.read_text(encoding="utf-8"))["source"]
    error = (simulated(path, t, theta, P1, P2) - theta) / DEG
    later, last = t - t[0] >= 2.0, np.arange(t.size) >= 0.6 * t.size
    assert np.sqrt(np.mean(error[later] ** 2)) == pytest.approx(said["rms_deg"], rel=0.05)
    assert np.sqrt(np.mean(error[last] ** 2)) == pytest.approx(said["rms_last_40_percent_deg"], rel=0.05)
    assert said["held_out_rms_deg"] < 1.5 * said["rms_last_40_percent_deg"]


@pytest.mark.slow
def test_a_file_says_the_error_that_its_numbers_make_on_a_log_of_a_joint_that_was_simulated(
    slow_joint, slow_fit, tmp_path
):
    plant = IdentifiedPlant.of(slow_fit)
    plant.save(tmp_path / "plant.toml")
    assert_the_file_is_as_it_says(tmp_path / "plant.toml", *slow_joint.rows)


@pytest.mark.slow
def test_a_file_says_the_error_that_its_numbers_make_on_the_sample_log(tmp_path):
    log = read_motion_log(ROOT / "examples" / "motion_log.csv")
    rows = [column[:2500] for column in (log.t, log.theta, log.P1, log.P2)]
    IdentifiedPlant.of(fit_motion(*rows, joint=JOINT)).save(tmp_path / "plant.toml")
    assert_the_file_is_as_it_says(tmp_path / "plant.toml", *rows)


@pytest.mark.slow
def test_an_encoder_zero_of_the_joints_file_is_that_of_its_plant(slow_joint, slow_fit, tmp_path):
    t, theta, P1, P2 = slow_joint.rows
    fit = fit_motion(t, theta + 33 * DEG, P1, P2, joint=JOINT, zero=33 * DEG)
    assert fit.error.every == pytest.approx(slow_fit.error.every, rel=1e-3)
    assert fit.moving.zero == pytest.approx(slow_fit.moving.zero + 33 * DEG, abs=0.1 * DEG)
    IdentifiedPlant.of(fit).save(tmp_path / "plant.toml")
    again = replay(tmp_path / "plant.toml", fit.log).errors().every
    assert again == pytest.approx(IdentifiedPlant.of(slow_fit).errors.every, rel=0.05)


@pytest.mark.slow
def test_damping_is_in_the_file_of_a_measured_joint_that_does_not_show_its_inertia(measured, tmp_path):
    muscle = SAROSI_DMSP_20_400N
    joint = AntagonistJoint(Lever(rest_length=0.25, anchor=0.1655, lever=0.05094, offset=0.051), muscle, muscle)
    rows = [column[:5000] for column in measured]  # two minutes
    fit, path = fit_motion(*rows, joint=joint), tmp_path / "plant.toml"
    IdentifiedPlant.of(fit).save(path)
    said = any(sentence.startswith("the inertia: ") for sentence in fit.unseen)
    # either model explains the log; which one is nearer depends on the processor
    assert said if "inertia" not in fit.parameters else fit.parameters["inertia"].low == 0.0
    plant, P = Plant.load(path), (float(fit.run.P1.mean()), float(fit.run.P2.mean()))
    K = float(plant.joint.stiffness(plant.joint.equilibrium(*P), *P))
    assert plant.damping / K == pytest.approx(fit.parameters["damping"].value, rel=1e-6)
    assert tomllib.loads(path.read_text(encoding="utf-8"))["source"]["held_out_rms_deg"] < 4.5  # 9 without the damping
    assert_the_file_is_as_it_says(path, *rows)


@pytest.mark.slow
def test_the_plant_that_is_written_is_one_that_mpc_takes(slow_fit, tmp_path):
    IdentifiedPlant.of(slow_fit).save(tmp_path / "plant.toml")
    plant, known = Plant.load(tmp_path / "plant.toml"), Compensation.load(tmp_path / "plant.toml")
    assert plant.joint == slow_fit.joint
    assert known.friction == MaxwellSlip.of(slow_fit.joint.hysteresis)
    assert known.dead_time == pytest.approx(DEAD_TIME, abs=0.015)
    assert (known.lag_up, known.lag_down) == pytest.approx((LAG, LAG), rel=0.15)
    assert plant.lags[0] == pytest.approx((known.lag_up + known.lag_down) / 2)
    assert plant.inertia == pytest.approx(0.002, rel=0.3)
    assert plant.damping == pytest.approx(0.05, rel=0.15)
    K = JOINT.stiffness(0.0, 2.5 * BAR, 2.5 * BAR)
    assert plant.joint.stiffness(0.0, 2.5 * BAR, 2.5 * BAR) == pytest.approx(K, rel=0.15)


@pytest.mark.slow
def test_an_inertia_that_the_log_shows_is_in_the_file(swinging_joint, swinging_fit):
    plant, written = swinging_joint[0], IdentifiedPlant.of(swinging_fit)
    assert written.plant.inertia == pytest.approx(plant.inertia, rel=0.3)
    assert written.assumed == ()
    assert written.plant.slew == written.seen_slew
    assert IdentifiedPlant.of(swinging_fit, {"slew": 8 * BAR}).plant.slew == 8 * BAR
    assert written.errors.every < 0.8 * DEG


@pytest.mark.slow
def test_a_damping_too_small_to_be_seen_is_assumed_and_its_plant_is_not_stiff(slow_fit):
    """Without inertia a damping of 1e-6 N·m·s/rad is 1e-7 s over the stiffness, in a log of 0.02 s."""
    fit = replace(slow_fit)
    for name in ("moving", "moving_early"):
        vars(fit)[name] = getattr(slow_fit, name)._replace(damping=1e-6, inertia=0.0)
    written = IdentifiedPlant.of(fit, {"damping": 0.07})
    assert written.assumed == ("damping", "inertia")
    numbers = tomllib.loads(written.text)["plant"]
    assert numbers["damping"] / fit.moving.stiffness > 0.4 * STEP
    assert np.isfinite(written.errors.every)


@pytest.mark.slow
def test_a_plant_without_an_angle_is_not_written(slow_fit, tmp_path):
    written = IdentifiedPlant.of(slow_fit)
    lost = replace(written, run=written.run._replace(theta=np.where(slow_fit.log.t < 3.0, 0.1, np.nan)))
    with pytest.raises(InvalidInput, match=r"cannot follow its own log: at 3 s"):
        lost.save(tmp_path / "plant.toml")
    assert not (tmp_path / "plant.toml").exists()


def test_regulators_of_a_file_are_those_of_the_simulated_plant_and_zero_lags_are_unknown(tmp_path):
    path = tmp_path / "plant.toml"
    Plant(JOINT, lag=0.2, gas=False).save(path)
    with path.open("a", encoding="utf-8") as file:
        file.write("\n[regulators]\ndead_time = 0.03\nlag_up = 0.1\nlag_down = 0.0\nflow = 3e5\n")
    known = Compensation.load(path)
    assert known == Compensation(dead_time=0.03, lag_up=0.1, flow=3 * BAR)
    real = RealPlant.of(Plant.load(path), known)
    experiment = real.begin(0.01, np.array([0.0, 0.0, 2.5 * BAR, 2.5 * BAR]), 0)
    for _ in range(13):
        experiment.advance(np.array([2.6, 2.4]) * BAR)
    P1, P2 = (experiment.x[2:] / BAR - 2.5) / 0.1
    assert P1 == pytest.approx(1 - np.exp(-0.1 / 0.1), rel=1e-4)
    assert P2 == pytest.approx(np.exp(-0.1 / 0.2) - 1, rel=1e-4)
    assert known.untold(Plant.load(path)) == "lag 0.1 s of a rising pressure"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("encoder_zero_deg = nan", "encoder_zero_deg = nan is not finite"),
        ("encoder_zero_deg = 1e9", "encoder_zero_deg = 1e\\+09 is over a turn"),
        ('encoder_zero_deg = "3"', "encoder_zero_deg = '3' is not a number"),
        ('pressures = "measured"', "pressures has to be 'commanded' or 'in the muscles'"),
    ],
)
def test_a_file_whose_source_was_edited_into_nonsense_is_not_replayed(tmp_path, line, said):
    save_machine(JOINT, tmp_path / "plant.toml")
    with (tmp_path / "plant.toml").open("a", encoding="utf-8") as file:
        file.write(f"\n[source]\n{line}\n")
    t = np.arange(0.0, 3.0, 0.1)
    with pytest.raises(InvalidFile, match=said):
        replay(tmp_path / "plant.toml", MotionLog(t, 0 * t, 2 * BAR + 0 * t, 2 * BAR + 0 * t))
