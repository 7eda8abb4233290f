"""Drift of a joint's strength over the stretches of its log."""

import numpy as np
import pytest

from allocator.identification.motion.doubt import Drift
from allocator.identification.motion.samples import MotionLog, joined

HOUR = 3600.0


def stretch(seed, gain):
    rng = np.random.default_rng(seed)
    t = 0.05 * np.arange(400)
    expected = 0.3 * np.sin(1.3 * t + rng.uniform(0, 6))
    return MotionLog(t, gain * expected + rng.normal(0, 0.01, 400), 2e5 + 0 * t, 2e5 + 0 * t), expected


@pytest.mark.parametrize("change", [0.0, -0.3])
def test_a_change_of_strength_is_found_with_its_doubt(change):
    """Sixteen stretches; the truth lies within three standard deviations, and shows only if there is one."""
    pieces = [stretch(1000 + k, 1 + change * k * 30 / HOUR) for k in range(16)]
    log = joined({str(k): log for k, (log, _) in enumerate(pieces)})
    predicted = np.concatenate([expected for _, expected in pieces])
    found = Drift.of(log, predicted)
    assert len(log.parts) == 16
    assert abs(found.per_hour - change) < 3 * found.std
    assert found.std < 0.1
    assert found.shows == (change != 0)


def test_a_log_in_one_piece_is_cut_into_eight():
    log, expected = stretch(7, 1.0)
    long = MotionLog(0.05 * np.arange(1600), *(np.tile(a, 4) for a in (log.theta, log.P1, log.P2)))
    assert Drift.of(long, np.tile(expected, 4)).gains.size == 8


def test_many_short_episodes_are_joined_to_eight_pieces():
    log, expected = stretch(7, 1.0)
    late = MotionLog(log.t + 5 * (np.arange(400) // 20), log.theta, log.P1, log.P2)
    assert len(late.parts) == 20
    assert Drift.of(late, expected).gains.size == 0  # 25 rows each
    t = np.concatenate([late.t, late.t + 200])
    long = MotionLog(t, *(np.tile(a, 2) for a in (log.theta, log.P1, log.P2)))
    assert Drift.of(long, np.tile(expected, 2)).gains.size == 8


def test_logs_with_and_without_measured_pressures_are_not_joined():
    from dataclasses import replace

    from allocator.errors import InvalidInput

    log, _ = stretch(7, 1.0)
    with pytest.raises(InvalidInput, match="some of the logs have measured1 and measured2"):
        joined({"one": log, "two": replace(log, measured=(log.P1, log.P2))})
