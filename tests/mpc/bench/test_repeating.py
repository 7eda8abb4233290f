"""A motion learned on a device: one repetition that does not count, safe stops between, and an end where one fails."""

import numpy as np
import pytest

from allocator.units import DEG
from mpc.bench.loop import RealTimeLoop
from mpc.bench.repeating import compared, finished, read, repeat
from mpc.repetition.learner import Learner
from mpc.repetition.response import Response

pytestmark = pytest.mark.parametrize("bench", ["joint", "arm"], indirect=True)
FREQUENCY = np.arange(0.0, 16.0, 0.1)


@pytest.fixture
def taught(bench):
    """A learner of the bench's motion, with a loop that is taken to lag by 50 ms, and what drives along a reference."""
    one = np.eye(bench.plant.n)
    lagging = Response(FREQUENCY, (1 / (1 + 2j * np.pi * FREQUENCY * 0.05))[:, None, None] * one)
    return Learner(bench.reference, (lagging,), bench.controller.dt, 3)


def loop_along(bench, reference):
    """Return the bench's loop along another reference."""
    first = bench.loop()
    settings = first.cycle.settings
    return RealTimeLoop(
        bench.device, bench.controller, bench.observer(), reference, start=settings.start, stop=settings.stop,
        clock=bench.clock,
    )  # fmt: skip


def driving(bench, commands):
    """Return what drives the bench along a reference; the pressures after each loop are added to `commands`."""

    def drive(reference):
        driven = loop_along(bench, reference)
        record = driven.run()
        commands.append(np.array(bench.device.commands[-1]))
        return record

    return drive


def test_the_error_falls_and_the_first_repetition_does_not_count(bench, taught):
    ends = []
    done = repeat(driving(bench, ends), taught)
    assert len(ends) == len(taught.history) + 1 == 4
    assert taught.gain > 1.5
    assert all(command.max() < 0.1e5 for command in ends)  # a safe stop after every one
    assert np.linalg.norm(done.best.theta_rms) < np.linalg.norm(done.first.theta_rms)
    wanted = done.best.values("theta_ref", phases=(2,))
    np.testing.assert_allclose(wanted[: taught.course.count], taught.course.wanted.theta, atol=1e-9)


def test_a_loop_that_does_not_finish_ends_it_and_keeps_what_was_learned(bench, taught):
    count = [0]

    def drive(reference):
        count[0] += 1
        driven = loop_along(bench, reference)
        if count[0] == 3:
            driven.stop()
        return driven.run()

    done = repeat(drive, taught)
    assert count[0] == 3
    assert not finished(done.last)
    assert len(taught.history) == 1
    assert not taught.done


def test_old_readings_are_brought_to_their_time(bench, taught):
    record = bench.loop().run()
    now, old = read(record, taught.course, 0.0), read(record, taught.course, 0.02)
    np.testing.assert_allclose(old[:-4], now[2:-2], atol=0.02 * DEG)
    assert compared(record, taught.course).theta_rms == pytest.approx(record.theta_rms, rel=1e-6)
