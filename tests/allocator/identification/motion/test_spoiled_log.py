"""A log as it comes: a gap, spikes, drop-outs and stamps in ns, as one CSV and as three bags of different kinds."""

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.identification import fit_motion
from allocator.identification.motion.plotting import plot_motion_fit
from allocator.identification.motion.samples import read_motion_log

from ....rigs.bags import TOPICS, mcap, ros1, ros2
from ....rigs.moving_joint import JOINT

pytestmark = pytest.mark.slow
BEGIN = 1_700_000_000_000_000_000  # [ns]
SPIKES = np.array([190, 433, 700, 951, 1210, 1777, 2003, 2222, 2500, 2871])
DROPS = ((333, 334), (1250, 1252), (2690, 2691))  # rows of P1 at zero
GAP = slice(1500, 1600)


@pytest.fixture(scope="module")
def spoiled(slow_joint):
    """Stamps [ns], angle [rad] and pressures [Pa]."""
    t, theta, P1, P2 = (np.array(a) for a in slow_joint.rows)
    theta[SPIKES] += np.resize([35, -50, 20, -28], SPIKES.size) * DEG
    for first, last in DROPS:
        P1[first:last] = 0.0
    kept = np.ones(t.size, bool)
    kept[GAP] = False
    stamps = BEGIN + np.round(t * 1e9).astype(np.int64)
    return stamps[kept], theta[kept], P1[kept], P2[kept]


def as_csv(path, rows):
    lines = ["stamp [ns],theta [deg],p1 [bar],p2 [bar]"]
    lines += [f"{t},{a / DEG:.6f},{p / BAR:.6f},{q / BAR:.6f}" for t, a, p, q in zip(*rows, strict=True)]
    path.write_text("\n".join(lines))
    return read_motion_log(path)


def as_bags(folder, rows):
    """Write a third of the rows each as ROS 1 bag, ROS 2 bag and MCAP file of JSON; read them as one log."""
    thirds = [[a[part] for a in rows] for part in np.array_split(np.arange(rows[0].size), 3)]
    paths = [write(folder, third) for write, third in zip((ros1, ros2, mcap), thirds, strict=True)]
    return read_motion_log(paths, topics=TOPICS)


def test_a_spoiled_log_gives_parameters_within_the_intervals_of_the_clean_one(spoiled, slow_fit, tmp_path):
    log, csv = as_bags(tmp_path, spoiled), as_csv(tmp_path / "log.csv", spoiled)
    assert log.n == spoiled[0].size - SPIKES.size - sum(last - first for first, last in DROPS)
    for one, other in ((log.theta, csv.theta), (log.P1, csv.P1), (log.P2, csv.P2)):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-7)  # the same rows
    assert all(any("spikes were left out" in note for note in read.notes) for read in (log, csv))
    found = fit_motion(log.t, log.theta, log.P1, log.P2, joint=JOINT)
    outside = {
        name: (clean.low, found.parameters[name].value, clean.high)
        for name, clean in slow_fit.parameters.items()
        if name not in found.parameters or not clean.low <= found.parameters[name].value <= clean.high
    }
    assert not outside
    assert found.error.every < 1.2 * slow_fit.error.every
    angles, errors, *_ = plot_motion_fit(found).axes
    starts = [part.start for part in found.log.parts[1:]]
    assert starts
    for axes in (angles, errors):
        for line in axes.lines:
            y = np.array(line.get_ydata())
            assert all(row >= y.size or np.isnan(y[row]) for row in starts)  # no line crosses a gap
