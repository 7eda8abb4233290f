"""The benchmark of the faults: what is counted, and that nothing is counted twice or not at all."""

import csv
from types import SimpleNamespace

import numpy as np
import pytest

from allocator import BAR
from mpc.model.faults import BrokenCable, DriftingSensor, StuckValve
from mpc.observer.health import WELL, FaultKind, Finding, Health, Part, Suspect

pytestmark = pytest.mark.slow

CABLE, LEAK = Suspect(FaultKind.BROKEN_CABLE, Part.MUSCLE_1), Suspect(FaultKind.LEAK, Part.MUSCLE_1)
DT = 0.01


@pytest.fixture
def part(benchmark_module):
    """A module of the benchmark, by its name."""
    return lambda name: benchmark_module(f"faults.{name}")


def suspecting(*suspects):
    return Health((Finding(suspects, 0.0),))


@pytest.fixture
def judged(part):
    """The row of a run of five seconds with a broken cable from 2 s on, of which `said` was said from the times on."""
    runs = part("runs")

    def judged(*said):
        healths = [WELL] * 500
        for begin, health in said:
            healths[round(begin / DT) :] = [health] * (500 - round(begin / DT))
        run = SimpleNamespace(dt=DT, u=np.zeros((500, 2)), P=np.zeros((501, 2)))
        job = runs.Job("standard", "steps", 1, "broken cable 1", 2.0)
        return runs.judged(job, BrokenCable(2.0), run, healths)

    return judged


def test_a_fault_that_nobody_suspects_is_not_detected(judged):
    row = judged()
    assert (row.false_alarms, row.at_once, row.after_all) == (0, "", "")
    assert np.isnan(row.delay)


def test_the_delay_counts_from_the_onset_and_the_name_at_the_alarm_and_a_second_later(judged):
    row = judged((2.5, suspecting(CABLE, LEAK)), (3.0, suspecting(CABLE)))
    assert (row.delay, row.late) == pytest.approx((0.5, 0.5))
    assert (row.at_once, row.after_all) == ("group", "right")
    assert judged((2.5, suspecting(CABLE)), (3.2, suspecting(LEAK))).after_all == "wrong"


def test_a_name_counts_as_it_last_was_if_the_suspicion_has_ended(judged):
    assert judged((2.5, suspecting(CABLE)), (3.0, WELL)).after_all == "right"


def test_what_is_suspected_before_the_onset_is_a_false_alarm(judged):
    row = judged((0.5, suspecting(LEAK)), (1.0, WELL), (1.5, suspecting(CABLE)), (1.6, WELL))
    assert (row.false_alarms, row.at_once) == (2, "")
    assert row.seconds == pytest.approx(2.0)
    assert row.first_false.startswith("leak")


def test_a_stuck_valve_matters_from_when_the_command_has_left_the_pressure(part):
    runs = part("runs")
    P = np.full((301, 2), 2 * BAR)
    u = P[:-1] + np.where(np.arange(300) >= 150, 0.5 * BAR, 0.0)[:, None]
    run = SimpleNamespace(dt=DT, u=u, P=P)
    late = runs.SETTINGS.compensation.delay(DT)
    assert runs._matters(StuckValve(1.0, muscle=1), run, 100, late) == 150 + late
    assert runs._matters(BrokenCable(1.0), run, 100, late) == 100
    assert runs._matters(DriftingSensor(1.0, sensor=2, rate=0.4 * BAR), run, 100, late) == pytest.approx(150, abs=1)


def test_there_are_three_hours_of_sound_motion(part):
    runs, main = part("runs"), part("__main__")
    sound = [job for job in main.jobs() if not job.fault]
    lasts = {name: runs.TRAJECTORIES[name].about(runs.K).t[-1] for name in runs.TRAJECTORIES}
    assert len(set(sound)) == len(sound)
    assert sum(lasts[job.trajectory] for job in sound) > 3 * 3600


def test_a_share_of_the_runs_is_of_the_runs(part):
    main = part("__main__")
    some, every = main.jobs(0.1), main.jobs()
    assert set(some) < set(every)
    assert len(some) == pytest.approx(len(every) / 10, abs=2)
    assert {job.fault for job in main.once()} == {job.fault for job in every}


@pytest.mark.parametrize("plants", ["strangers", "identified"])
def test_strangers_have_every_fault_and_sound_runs(part, plants):
    main, cases = part("__main__"), part("cases")
    every = main.jobs(plants=plants)
    assert {job.plant for job in every} == set(main.PLANTS[plants])
    assert {job.fault for job in every} == {"", *cases.FAULTS}
    models = [job.model for job in every]
    assert models == sorted(models)
    assert {job.model for job in main.jobs()} == {""}


@pytest.mark.compiles
def test_a_fault_of_a_stranger_has_its_effect(part):
    cases, rest = part("cases"), np.array([0.0, 0.0, 2 * BAR, 2 * BAR])
    faulty = (cases.with_fault("tips 0", fault, 0.1) for fault in ("broken cable 1", "stuck valve 1"))
    sound, cut, stuck = (each.begin(DT, rest, 0) for each in (cases.stranger("tips 0"), *faulty))
    for k in range(40):
        for trial in (sound, cut, stuck):
            trial.advance(np.array([2.0 + 0.5 * (k > 10), 2.0]) * BAR)
    assert cut.x[0] < sound.x[0] - 0.2  # muscle 2 alone pulls
    assert sound.x[2] > stuck.x[2] + 0.1 * BAR


def test_the_loop_names_a_broken_cable_and_leaves_a_sound_joint_alone(part, tmp_path):
    runs, report = part("runs"), part("report")
    rows = [runs.row(job) for job in (
        runs.Job("standard", "steps", 1, "broken cable 1", 2.0), runs.Job("standard", "jumps", 1, load=1.0)
    )]  # fmt: skip
    broken, sound = rows
    assert broken.delay < 0.2
    assert (broken.at_once, broken.after_all) == ("group", "right")  # the gas that the jerk moves hides it at first
    assert (sound.false_alarms, sound.seconds) == (0, pytest.approx(8.5))
    text = "\n".join(report.markdown(rows, planned=9))
    assert "2 of 9 runs were made" in text
    assert "| broken cable 1 | 1 | 100.0 % |" in text
    assert "0 in 0.00 h of motion without a fault" in text
    report.save(rows, tmp_path / "faults.csv")
    with (tmp_path / "faults.csv").open(encoding="utf-8") as file:
        assert [line["fault"] for line in csv.DictReader(file)] == ["broken cable 1", ""]
