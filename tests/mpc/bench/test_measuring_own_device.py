"""Measured stiffness on a device of a user: own equations, own functions, and the faults of a first attempt."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.errors import InvalidInput
from mpc import Compensation, Plant, RealPlant
from mpc.bench import CallableDevice, SimulatedClock, SimulatedDevice, Told, Tones, measure, shake
from mpc.bench.measuring.log import Samples, from_log
from mpc.bench.measuring.strengths import Known, why_implausible
from mpc.cli import app

STRENGTHS, STEP = (1.08, 0.94), 1e-3
MODEL = replace(RealPlant.standard().nominal, inertia=0.045, lag=0.05, slew=20 * BAR)
KNOWN = Compensation(flow=10 * BAR)


class Rig:
    """A joint of two first-order regulators and a little friction, integrated up to the time of each call."""

    def __init__(self, clock, fault=lambda reading, rng: reading):
        self.clock, self.fault, self.rng = clock, fault, np.random.default_rng(1)
        self.theta = self.omega = self.slip = 0.0
        self.P, self.u, self.t = np.zeros(2), np.zeros(2), clock.now()

    def run(self):
        while self.t < self.clock.now() - STEP / 2:
            sides = MODEL.joint.sides(self.theta)
            T = sum(g * float(s.torque(P)) for g, s, P in zip(STRENGTHS, sides, self.P, strict=True))
            self.slip = float(np.clip(self.slip + self.omega * STEP / (1 * DEG), -1, 1))
            self.omega += STEP * (T - 0.05 * self.slip - 0.12 * self.omega) / MODEL.inertia
            self.theta += STEP * self.omega
            self.P = self.P + STEP * (self.u - self.P) / 0.05
            self.t += STEP

    def read(self):
        self.run()
        P = self.P + 0.02 * BAR * self.rng.standard_normal(2)
        return self.fault((round(self.theta / (0.05 * DEG)) * 0.05 * DEG, float(P[0]), float(P[1])), self.rng)

    def write(self, P1, P2):
        self.run()
        self.u = np.array([P1, P2])


def tried(fault=lambda reading, rng: reading, plant=MODEL, tones=None):
    """The measurement of a rig with a fault, told with a model."""
    clock = SimulatedClock()
    rig = Rig(clock, fault)
    device = CallableDevice(rig.read, rig.write, clock=clock)
    return measure(device, Told(plant, KNOWN), 0.0, 6.0, clock=clock, tones=tones or Tones(series=()))[0]


def some_missing(reading, rng):
    return (np.nan,) * 3 if rng.random() < 0.1 else reading


@pytest.mark.slow
def test_a_joint_behind_two_functions_is_measured_with_some_readings_missing_and_amplitudes_without_time():
    m = tried(some_missing, tones=Tones(series=(3 * DEG, 5 * DEG), longest=42.0))
    assert m.success, m.sentence
    assert m.left_out == (3 * DEG, 5 * DEG)
    assert [cells[1] for cells in m.rows].count("no time left") == 2
    assert m.to_dict()["amplitudes_left_out_deg"] == pytest.approx([3, 5])
    for g, s, true in zip(m.strengths, m.strengths_std, STRENGTHS, strict=True):
        assert abs(g - true) < 3 * s
        assert s < 0.05


@pytest.mark.slow
def test_a_joint_with_unknown_friction_and_dead_band_is_measured():
    clock = SimulatedClock()
    device = SimulatedDevice(RealPlant.standard(), clock, seed=3)
    told = Told(device.plant.nominal, Compensation(dead_time=0.03))
    m, _ = measure(device, told, 0.1, 6.0, clock=clock, tones=Tones(series=()))
    assert m.success, m.sentence
    for g, s, true in zip(m.strengths, m.strengths_std, device.plant.force_gains, strict=True):
        assert abs(g - true) < 2 * s


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "why"),
    [
        (lambda r, _: (r[0], r[1] / BAR, r[2] / BAR), "muscle 1 does not follow its command"),
        (lambda r, _: (r[0], r[2], r[1]), "muscle 1 does not follow its command"),
        (lambda r, _: (0.0, r[1], r[2]), "check the encoder"),
        (lambda r, _: (-r[0], r[1], r[2]), "which muscle is the agonist"),
    ],
)
def test_a_fault_of_the_wiring_is_named(fault, why):
    m = tried(fault)
    assert not m.success
    assert why in m.refusal


@pytest.mark.slow
def test_an_inertia_in_another_unit_is_refused_before_the_joint_is_thrown():
    m = tried(plant=replace(MODEL, inertia=45.0))
    assert "check the unit of the inertia" in m.refusal
    assert m.furthest == 0


def test_strengths_far_from_the_model_are_implausible():
    assert why_implausible((1.9, 0.6)) == ""
    for strengths in ((2.1, 1.0), (1.0, 0.4), (-1.0, -1.0)):
        assert "check the inertia" in why_implausible(strengths)


@pytest.mark.parametrize("how", [measure, shake])
def test_a_rest_that_the_joint_does_not_have_is_refused_before_the_first_command(how):
    sent = []
    device = CallableDevice(lambda: (0.0, 0.0, 0.0), lambda *P: sent.append(P), clock=SimulatedClock())
    given = {"amplitude": 10 * DEG} if how is shake else {}
    for theta, K, why in ((0.0, 1000.0, "in the way: P1 upper"), (3.0, 6.0, "beyond the joint range")):
        with pytest.raises(InvalidInput, match=why):
            how(device, Told(MODEL, KNOWN), theta, K, clock=SimulatedClock(), **given)
    assert not sent


def test_samples_have_to_resolve_the_tones():
    device = CallableDevice(lambda: (0.0, 0.0, 0.0), lambda *P: None, clock=SimulatedClock())
    for given in ({"dt": 0.1}, {"tones": Tones(low=50.0)}):
        with pytest.raises(InvalidInput, match="16 samples per period"):
            measure(device, Told(MODEL, KNOWN), 0.0, 6.0, clock=SimulatedClock(), **given)
    with pytest.raises(InvalidInput, match="between 0 and 1 rad"):
        Tones(series=4)


@pytest.mark.slow
def test_a_log_with_another_unit_of_time_is_refused():
    rng, dt = np.random.default_rng(0), 0.01
    x, rows, u = MODEL.at_rest(0.0, 6.0), [], None
    moving = MODEL.begin(dt, x, 0)
    for k in range(3000):
        u = x[2:] + rng.uniform(-1, 1, 2) * BAR if k % 20 == 0 else u
        theta, _, *P = moving.measure()[:4]
        rows.append((k * dt, theta, *P))
        moving.advance(u)
    t, *others = np.array(rows).T
    assert from_log(MODEL, MODEL.joint.loop, Samples.of(t, *others), Known(0.045)).success
    slow = from_log(MODEL, MODEL.joint.loop, Samples.of(10 * t, *others), Known(0.045))
    assert "times as hard as their models" in slow.refusal


def refused(*arguments):
    from typer.testing import CliRunner

    run = CliRunner().invoke(app, ["measure", *arguments])
    assert isinstance(run.exception, InvalidInput), run.output
    assert "about" not in run.output  # before the first motion
    return str(run.exception)


def test_the_command_checks_everything_before_the_first_motion(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Plant(MODEL.joint, 0.045).save("joint.toml")
    sim = ["--machine", "joint.toml", "--device", "sim", "--fast", "--quiet"]
    assert "no rest at 10°" in refused(*sim, "--around", "10:6", "--around", "10:100")
    assert "--dt 0.1: expected 0.001 to 0.05 s" in refused(*sim, "--dt", "0.1")
    assert "name its file" in refused(*sim, "--columns", "theta=phi:deg")
    assert "name it with --machine" in refused("--device", "sim", "--fast", "--update")


def test_the_inertia_has_to_be_known(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Plant(MODEL.joint, 0.045).save("fitted.toml")
    text = (tmp_path / "fitted.toml").read_text()
    (tmp_path / "fitted.toml").write_text(text + "\n[intervals]\ninertia = [0.005, 0.012]\n")
    (tmp_path / "static.toml").write_text(text[: text.index("[plant]")])
    device = "--device", "serial:/dev/none"
    assert "was fitted in proportion to the model's stiffness" in refused("--machine", "fitted.toml", *device)
    assert "is not in --machine" in refused("--machine", "static.toml", *device)
    t = np.arange(0, 60, 0.01)
    rows = np.column_stack([t, 3 * np.sin(t), 2 + 0.5 * np.sin(t), 2 - 0.5 * np.sin(t)])
    head = "time [s],theta [deg],pressure1 [bar],pressure2 [bar]"
    np.savetxt("log.csv", rows, delimiter=",", header=head, comments="")
    asked = refused("log.csv", "--machine", "static.toml")
    assert "give --inertia" in asked
    assert "--weight" not in asked
