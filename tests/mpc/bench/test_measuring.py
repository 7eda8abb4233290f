"""Measured stiffness: loops of any waveform, strengths of hidden joints, refusals, and the updated file."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG, PrandtlIshlinskii, allocate
from allocator.errors import InvalidInput
from allocator.machine_file import load_joint
from benchmarks.felt.hidden import hidden
from benchmarks.felt.hidden import measured as hidden_measured
from benchmarks.felt.refusals import Rubber
from mpc import Plant
from mpc.bench.cycle import Cycle, Settings
from mpc.bench.device import SimulatedClock
from mpc.bench.devices.simulated import SimulatedDevice
from mpc.bench.measuring.driving import Driver, Search, Wave, room
from mpc.bench.measuring.experiment import Experiment, Tones
from mpc.bench.measuring.loops import tone_of
from mpc.bench.measuring.result import MeasuredStiffness, plot_measured
from mpc.bench.measuring.session import Told, encoder_step, measure, result_of
from mpc.bench.measuring.simulation import driven
from mpc.bench.measuring.springs import backbone, secant, stop
from mpc.bench.measuring.strengths import Known, Load, solve
from mpc.bench.measuring.update import combined, strengthened, update
from mpc.bench.measuring.weighing import Weight
from mpc.model.friction.contact import Loads
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.real import RealPlant

OPERATOR = PrandtlIshlinskii((0.7, 0.12, 0.1, 0.08), (0.5 * DEG, 1.5 * DEG, 4 * DEG), base=0.2)
NOMINAL = replace(RealPlant.standard().nominal, inertia=0.045)
GAINS = 1.1, 0.93
REAL = replace(
    RealPlant.standard(GAINS, nominal=replace(NOMINAL, joint=replace(NOMINAL.joint, hysteresis=OPERATOR))),
    friction=OPERATOR,
    dead_band=0.05 * BAR,
    flow=8 * BAR,
)
KNOWN = replace(REAL.known(), friction=REAL.friction, flow=8 * BAR)
QUICK = Tones(series=(6 * DEG,))


def loop_of(friction, way, t, f):
    """The tone of a way of the angle (n,), for which muscles take the torque of hysteresis alone."""
    contact = Loads.of(NOMINAL, np.array([0.0, 0.0, 2.5 * BAR, 2.5 * BAR]))
    memory = friction.begun(0.0)
    for _ in range(30):
        memory = friction.along(memory, np.concatenate([[0.0], way]), contact)[-1]
    T = np.array([friction.torque(m, contact) for m in friction.along(memory, way, contact)])
    return tone_of(t, way, np.zeros((t.size, 2)), np.column_stack([T, 0 * T]), f).loop()


@pytest.mark.parametrize("friction", [MaxwellSlip((4.0, 3.0), (1 * DEG, 3 * DEG)), Friction(0.0, 0.1, 1.0 * DEG)])
def test_secant_and_work_of_a_loop_do_not_ask_for_its_waveform(friction):
    f, A = 1.0, 2 * DEG
    t = np.arange(0, 3, 0.001)
    phase = 2 * np.pi * f * t
    sine, peaked = np.sin(phase), (np.sin(phase) - 0.12 * np.sin(3 * phase)) / 1.12
    one, two = (loop_of(friction, A * way, t, f) for way in (sine, peaked))
    assert two.swing == pytest.approx(one.swing, rel=0.01)
    assert two.secants[0] == pytest.approx(one.secants[0], rel=0.03)
    assert two.losses[0] == pytest.approx(one.losses[0], rel=0.03)
    assert two.means[0] == pytest.approx(one.means[0], rel=0.01)
    secant = friction.loop.secant(A)
    contact = Loads.of(NOMINAL, np.array([0.0, 0.0, 2.5 * BAR, 2.5 * BAR]))
    state = contact.stiffness, contact.pulled, contact.filled
    assert one.secants[0] == pytest.approx(secant.added(*state), rel=0.03)
    assert one.losses[0] == pytest.approx(secant.work(*state) / (np.pi * A**2), rel=0.03)


def test_the_mean_over_the_stroke_finds_a_spring_and_an_inertia_in_any_waveform():
    t, A, K, J = np.arange(0, 3, 0.001), 2 * DEG, 7.0, 0.05
    w = 2 * np.pi
    theta = A * (np.sin(w * t) - 0.15 * np.sin(3 * w * t) + 0.04 * np.sin(5 * w * t))
    bend = -A * w**2 * (np.sin(w * t) - 9 * 0.15 * np.sin(3 * w * t) + 25 * 0.04 * np.sin(5 * w * t))
    loop = tone_of(t, theta, np.zeros((t.size, 2)), np.column_stack([K * theta, J * bend]), 1.0).loop()
    assert loop.means[0] == pytest.approx(K, rel=1e-6)
    assert loop.means[1] == pytest.approx(-J * loop.mean_acceleration, rel=1e-3)
    assert loop.mean_acceleration != pytest.approx(w**2, rel=0.05)


def sliding(J, K, most, presliding, f, h=1e-4):
    """Angles and friction (60000, 2) of a mass on a spring with friction of `most` [N·m] under a sine of 0.55 N·m."""
    theta = omega = friction = 0.0
    out = []
    for k in range(round(6 / h)):
        out.append((theta, friction))
        omega += h / J * (0.55 * np.sin(2 * np.pi * f * k * h) - K * theta - friction)
        theta += h * omega
        friction = float(np.clip(friction + most / presliding * h * omega, -most, most))
    return np.array(out)


@pytest.mark.parametrize("f", [0.8, 1.2])
@pytest.mark.parametrize("presliding", [0.1 * DEG, 0.3 * DEG])
@pytest.mark.parametrize("most", [0.1, 0.2, 0.3])
def test_a_tone_has_the_stiffness_of_a_push_although_friction_reverses_at_its_turns(most, presliding, f):
    J, K, t = 0.05, 6.0, np.arange(0, 6, 0.01)
    late = t >= 6 - 3 / f - 1e-6
    fine = sliding(J, K, most, presliding, f)
    theta, T = fine[::100, 0][late], 0.55 * np.sin(2 * np.pi * f * t[late])
    tone = tone_of(t[late], theta, np.zeros((theta.size, 2)), np.column_stack([T, 0 * T]), f)
    pushed = K + most / (np.ptp(theta) / 2)
    assert secant(tone, np.ones(2), 0.0, J, 0.0) == pytest.approx(pushed, rel=0.03)
    angle, friction = (fine[-round(1e4 / f) :] - fine[-round(1e4 / f) :].mean(axis=0)).T
    stroke = angle * np.abs(np.gradient(angle))
    mean, loop = K + (friction @ stroke) / (angle @ stroke), tone.loop()
    assert loop.means[0] + J * loop.mean_acceleration == pytest.approx(mean, rel=0.015)


@pytest.mark.parametrize("springs", [((4.0, 0.5),), ((2.0, 0.3), (1.5, 2.0)), ((1.0, 1.0), (1.0, 3.0))])
def test_loops_of_several_amplitudes_have_the_backbone_that_does_not_slip(springs):
    """Springs (w [N·m/rad], r [°]) that slip."""
    K, J, f, t = 6.0, 0.05, 1.0, np.arange(0, 4, 0.01)
    tones = []
    for A in (3 * DEG, 4.2 * DEG, 8 * DEG):
        theta = A * np.sin(2 * np.pi * f * t)
        T = (K - J * (2 * np.pi * f) ** 2) * theta + sum(w * stop(theta, r * DEG) for w, r in springs)
        T, late = np.column_stack([T, 0 * T]), t >= 1
        tones.append(tone_of(t[late], theta[late], np.zeros((late.sum(), 2)), T[late], f))
    assert backbone(tones, np.ones(2), 0.0, J, 0.0) == pytest.approx(K, rel=0.03)


@pytest.mark.parametrize("exponent", [0.25, 0.6, 1.0])
def test_a_search_finds_the_drive_of_a_power_law_and_keeps_its_exponent(exponent):
    search = Search(3.0, 0.8)
    for _ in range(3):
        search.learn(3.0 * (search.scale / 0.9) ** (1 / exponent), cut=False)
    assert search.exponent == pytest.approx(exponent)
    assert search.scale == pytest.approx(0.9, rel=0.01)
    again = Search(3.0, 0.8, search.exponent)
    again.learn(3.0 * (again.scale / 0.9) ** (1 / exponent), cut=False)
    assert again.scale == pytest.approx(0.9, rel=1e-6)


@pytest.mark.parametrize(("f", "beyond"), [(0.01, False), (4.0, True)])
def test_commands_may_leave_the_room_of_lagging_pressures_but_not_the_supply(f, beyond):
    plant = replace(NOMINAL, lag=0.13)
    driver = Driver(plant, 0.01, (1.5 * BAR, 1.4 * BAR), 0.0, 3 * DEG)
    most, behind = np.array(room(plant, 0.0, driver.first)), np.arctan(2 * np.pi * f * np.array(plant.lags))
    wave = driver._within(Wave(f, np.full(2, 9 * BAR), np.full(2, 0.04 * BAR), behind))
    assert (wave.drive * np.cos(behind) <= most * (1 + 1e-9)).all()
    assert (wave.drive + wave.dead <= np.array(driver.first) * (1 + 1e-9)).all()  # the supply begins at 0
    assert bool((wave.drive > 2 * most).all()) is beyond


@pytest.mark.parametrize(("drive", "why"), [(0.1 * BAR, "friction jumps"), (4 * BAR, "choose a stiffer rest")])
def test_a_swing_that_slack_cables_leave_no_room_for_is_told_from_friction_that_jumps(drive, why):
    e = Experiment(REAL.nominal, KNOWN, 0.1, 6.0, 0.01, QUICK)
    wanted = Wave(1.2, np.full(2, drive), np.zeros(2), np.zeros(2))
    assert why in str(e._apart(2 * DEG, wanted))
    assert "friction jumps" in str(e._apart(4 * DEG, wanted))  # farther than wanted: ±3°


def test_strengths_of_exact_tones_are_exact():
    """A linear joint: K + iωD - Jω² with strengths, an age of the readings, and no noise."""
    J, K, D, age, g = 0.05, 8.0, 0.2, 0.01, (1.1, 0.9)
    t, tones = np.arange(0, 4, 0.01), []
    for f, (a, b) in ((1, (1, 0)), (1, (0, 1)), (1, (0.5, 0.5)), (0.5, (0.5, 0.5)), (4, (0.6, 0.4)), (4.5, (0.5, 0.5))):
        w, A = 2 * np.pi * f, (2.1 if len(tones) == 2 else 1.5) * DEG
        Z = (K + 1j * w * D - J * w**2) * A
        T = np.column_stack([(s * Z / gi * np.exp(1j * w * t)).real for s, gi in zip((a, b), g, strict=True)])
        theta = (A * np.exp(1j * w * (t - age))).real
        tones.append(tone_of(t, theta, np.zeros((t.size, 2)), T, f))
    found = solve(tones, 1.5 * DEG, Known(J, age=age))
    assert found.strengths == pytest.approx(g, rel=1e-4)
    assert found.values["K"] == pytest.approx(K, rel=1e-4)
    assert found.values["D"] == pytest.approx(D, rel=1e-3)
    assert abs(found.rate) < 1e-3


def test_the_balance_of_mean_torques_outweighs_tones_that_scatter():
    """Friction of the tones of one muscle each that differs by ±3 %, and the noise of pressures."""
    J, K, g, A, rng, t = 0.05, 8.0, np.array([1.1, 0.9]), 3 * DEG, np.random.default_rng(0), np.arange(0, 3, 0.01)
    low = ((1, (1, 0), 1.03), (1, (0, 1), 0.97), (1, (0.5, 0.5), 1), (0.5, (0.5, 0.5), 1))
    balance = Load((2 / 1.1, -2 / 0.9), 0.0, 0.05)
    errors = []
    for _ in range(4):
        tones = []
        for f, shares, more in (*low, (4, (0.6, 0.4), 1), (4, (0.4, 0.6), 1)):
            theta = (1.4 if len(tones) == 2 else 1.0) * A * np.cos(2 * np.pi * f * t)
            T = np.outer(theta, (more * K - J * (2 * np.pi * f) ** 2) * np.array(shares) / g)
            tones.append(tone_of(t, theta, 0 * T, T + 0.1 * rng.standard_normal(T.shape), f))
        one, two = solve(tones, A, Known(J, loads=(balance,))).strengths / g
        errors.append(one / two - 1)
    assert np.sqrt(np.mean(np.square(errors))) < 0.014


@pytest.fixture(scope="module")
def measured():
    e = Experiment(REAL.nominal, KNOWN, 0.1, 6.0, 0.01, QUICK)
    rows = driven(REAL, e, REAL.nominal, 0.1, seed=3)
    known = Known(REAL.nominal.inertia)
    return rows, e, MeasuredStiffness.of(REAL.nominal, REAL.friction.loop, e.findings, known, REAL.encoder)


@pytest.mark.slow
def test_a_hidden_joint_is_measured_within_its_errors(measured):
    rows, e, m = measured
    assert m.success, m.sentence
    for g, s, true in zip(m.strengths, m.strengths_std, GAINS, strict=True):
        assert abs(g - true) < 3 * s
        assert s < 0.06
    x = np.array([m.theta, 0.0, *m.pressures])
    K = float(REAL.isobaric(x))
    assert abs(m.K - K) < 3 * m.K_std
    assert m.K_std < 0.08 * K
    for f in m.felt:
        contact = Loads.of(REAL, x)
        felt = K + REAL.friction.loop.secant(f.amplitude).added(K, contact.pulled, contact.filled)
        assert abs(f.K - felt) < 3 * f.K_std
    low, high = REAL.nominal.pressure_limits
    assert ((rows[:, 4:] >= low) & (rows[:, 4:] <= high)).all()
    assert np.abs(np.diff(rows[:, 4:], axis=0)).max() <= REAL.nominal.slew * 0.01 * (1 + 1e-9)
    assert e.findings.duration <= 60
    assert encoder_step(rows[:, 1]) == pytest.approx(REAL.encoder, rel=1e-6)
    axes = plot_measured([m], REAL.nominal.joint, REAL.friction.loop).axes[0]
    assert len(axes.get_legend().get_texts()) == 4


@pytest.mark.slow
def test_a_joint_on_a_device_is_measured_with_soft_start_and_safe_stop():
    clock = SimulatedClock()
    device = SimulatedDevice(REAL, clock, seed=5)
    told = Told(REAL.nominal, KNOWN, inertia_error=0.05)
    m, cycle = measure(device, told, 0.1, 6.0, clock=clock)
    assert m.success, m.sentence
    assert min(m.strengths_std) > 0.045  # of the inertia
    assert str(cycle.ending.reason) == "finished"
    assert device.command == pytest.approx([0.0, 0.0])


@pytest.mark.slow
def test_a_weight_fixes_the_scale_where_the_inertia_is_hardly_known_and_checks_it_where_it_is():
    clock = SimulatedClock()
    device = SimulatedDevice(REAL, clock, seed=5)
    wrong = replace(REAL.nominal, inertia=1.3 * REAL.nominal.inertia)
    weight, tones = Weight(1.0, device.hang), Tones(series=(8 * DEG,), longest=80.0)
    source = Experiment(wrong, KNOWN, 0.1, 6.0, 0.01, tones, weight)
    cycle = Cycle(device, source, wrong, Settings(), clock=clock)
    ending = cycle.run()
    found = {e: result_of(source, Told(wrong, KNOWN, e), ending, cycle.recorder.columns["theta"]) for e in (0.5, 0.02)}
    m = found[0.5]
    assert m.success, m.sentence
    assert m.scale.ratio == pytest.approx(1 / 1.3, rel=0.05)
    assert abs(m.scale.ratio - 1 / 1.3) < 3 * m.scale.std
    for g, s, true in zip(m.strengths, m.strengths_std, GAINS, strict=True):
        assert abs(g - true) < 3 * s
        assert s < 0.06
    assert "by the weight the inertia is 0.7" in found[0.02].sentence


@pytest.mark.slow
def test_what_cannot_be_measured_is_refused():
    tones = Tones(0.1 * DEG, series=())
    real = replace(REAL, friction=Friction(), encoder=0.1 * DEG)
    e = Experiment(REAL.nominal, replace(KNOWN, friction=Friction()), 0.1, 6.0, 0.01, tones)
    driven(real, e, REAL.nominal, 0.1, seed=3)
    m = MeasuredStiffness.of(REAL.nominal, real.friction.loop, e.findings, Known(0.045), real.encoder)
    assert not m.success
    assert m.sentence.startswith("not measured, because")
    with pytest.raises(InvalidInput, match="nothing was measured"):
        combined([m])


def test_a_rest_at_the_end_of_the_supply_is_refused_at_once():
    e = Experiment(REAL.nominal, KNOWN, 0.0, 9.45, 0.01, QUICK)
    driven(REAL, e, REAL.nominal, 0.0, seed=3)
    assert "at this rest muscle 1 has 5 bar, which the supply of 0 … 5 bar leaves no room" in e.findings.refusal
    assert "choose a softer rest" in e.findings.refusal
    assert e.findings.duration < 2


def test_the_amplitude_is_planned_for_the_least_frequency_that_is_calm():
    e = Experiment(REAL.nominal, replace(KNOWN, flow=1.2 * BAR), 0.1, 6.0, 0.01, QUICK)
    assert e._planned() == 3 * DEG
    stiffness = 1.1 * e._expected(3 * DEG)
    assert not e._follows(1.5 * e._resonance(stiffness), 0.6, stiffness)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1017, 1034])
def test_a_joint_that_jumps_is_refused_within_a_minute(seed):
    m = hidden_measured(hidden(seed), seed).measured
    assert "too short to bring the amplitudes together" in m.refusal
    assert 40 < m.duration <= 60


@pytest.mark.slow
def test_a_joint_with_rubber_is_refused_and_without_it_measured():
    seed = 204
    h = hidden(seed)
    calm = h._replace(
        real=replace(h.real, friction=Friction(), encoder=0.02 * DEG), told=replace(h.told, friction=Friction())
    )
    rubbery = calm._replace(real=Rubber(**vars(calm.real)))
    assert hidden_measured(calm, seed).measured.success
    assert "depends on the rate" in hidden_measured(rubbery, seed).measured.refusal


@pytest.mark.slow
def test_muscles_of_different_strengths_that_friction_held_are_told_apart():
    """The joint slides by 8° to its true rest while it is first shaken: torques are those of the rest."""
    h = hidden(43)
    h = h._replace(real=replace(h.real, force_gains=(1.2, 0.85)))
    found = hidden_measured(h, 43)
    assert found.measured.success, found.measured.sentence
    assert abs(found.measured.theta - h.theta) > 6 * DEG
    one, two = found.strengths
    assert abs(one - two) < 0.03


def like(strengths, covariance, theta=0.1):
    """A measurement that found these strengths."""
    P = 2.5 * BAR, 2.4 * BAR
    return MeasuredStiffness(
        theta, P, strengths, np.array(covariance), 6.0, 0.1, 6.0, age=0.0, duration=50.0, furthest=1.5
    )


def test_an_update_changes_the_muscles_and_keeps_everything_else(tmp_path):
    path = tmp_path / "joint.toml"
    joint = replace(NOMINAL.joint, hysteresis=OPERATOR)
    Plant(joint, 0.045).save(path)
    path.write_text(path.read_text() + "\n[regulators]  # mine\ndead_time = 0.02\n")
    kept = path.read_text()
    after = update(path, [like((1.1, 0.9), np.diag([4e-4, 1e-4]))], 0.045, now="2026-11-24T12:00:00")
    text = path.read_text()
    assert "[regulators]  # mine\ndead_time = 0.02" in text
    assert kept[: kept.index("[[muscle]]")] in text
    assert after == load_joint(path)
    at = 0.1, 2.5 * BAR, 2.4 * BAR
    forces = [g * F for g, F in zip((1.1, 0.9), joint.forces(*at), strict=True)]
    assert after.forces(*at) == pytest.approx(forces, rel=1e-9)
    one, two = (side.stiffness(P) for side, P in zip(joint.sides(0.1), at[1:], strict=True))
    a = allocate(0.1, float(after.stiffness(*at)), float(after.torque(*at)), joint=after)
    assert a.K_std == pytest.approx(np.hypot(0.02 * one, 0.01 * two), rel=1e-6)
    assert Plant.load(path).inertia == 0.045
    again = update(path, [like((1.0, 1.0), np.diag([4e-4, 1e-4]))], 0.045)
    assert path.read_text().count("[[measured]]") == 2
    assert again.stiffness(*at) == pytest.approx(after.stiffness(*at), rel=1e-9)


def test_both_muscles_of_one_law_keep_its_common_errors_when_they_are_updated():
    law = NOMINAL.joint.agonist
    rows = np.diag((0.02 * np.array(list(law.parameters.values()))) ** 2)
    fitted = replace(law, covariance=tuple(map(tuple, rows)))
    joint = replace(NOMINAL.joint, agonist=fitted, antagonist=fitted)
    after = strengthened(joint, np.ones(2), np.zeros((2, 2)))
    a, b = (allocate(0.1, 6.0, 0.5, joint=one).K_std for one in (joint, after))
    assert b == pytest.approx(a, rel=1e-9)


def test_measurements_about_several_rests_are_weighed_and_the_inertia_is_common():
    C = np.diag([4e-4, 4e-4])
    common = 0.05**2
    g, found = combined([like((1.0, 1.0), C + common), like((1.02, 0.98), C + common)], 0.05)
    assert g == pytest.approx([1.01, 0.99], abs=1e-3)
    assert found[0, 0] == pytest.approx(2e-4 + common, rel=0.05)


def test_a_law_that_does_not_scale_is_refused():
    with pytest.raises(InvalidInput, match="positive"):
        strengthened(NOMINAL.joint, np.array([1.0, -1.0]), np.eye(2))


@pytest.mark.slow
def test_the_command_measures_updates_draws_and_refuses(tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from mpc.cli import app

    monkeypatch.chdir(tmp_path)
    Plant(replace(NOMINAL.joint, hysteresis=OPERATOR), 0.045).save("joint.toml")
    with open("joint.toml", "a") as file:
        file.write("\n[regulators]\ndead_band = 5000.0\nflow = 800000.0\n")
    common = ["measure", "--machine", "joint.toml", "--device", "sim:joint.toml", "--fast", "--quiet", "--series", "6"]
    run = CliRunner().invoke(app, [*common, "--around", "5:6", "--weight", "1", "--update", "--out", "felt.png"])
    assert run.exit_code == 0, run.output
    assert "inertia by the weight" in run.output
    assert "backbone K" in run.output
    assert (tmp_path / "felt.png").stat().st_size > 1000
    assert (tmp_path / "joint.toml").read_text().count("[[measured]]") == 1
    for around, why in (("5", "ANGLE:STIFFNESS"), ("500:6", "the joint's range")):
        refused = CliRunner().invoke(app, [*common, "--around", around])
        assert isinstance(refused.exception, InvalidInput)
        assert why in str(refused.exception)
