"""Parts of the campaign of wrong readings, and the report on them."""

import numpy as np
import pytest

from ..rigs.needs import needs

pytestmark = pytest.mark.slow

SPAN = 5e5  # [Pa]


@pytest.fixture
def storm(benchmark_module):
    return benchmark_module("robustness.storm")


def test_a_storm_of_wrong_readings_breaks_no_limit_and_passes(storm):
    (part,) = storm.driven(4000, 1, seed=11)
    assert storm.broken(part.run) == []
    assert np.median(part.error) < 0.5
    assert np.mean(part.error > 5) < 0.03
    assert sum(np.isfinite(recovery.seconds) for recovery in part.recoveries) >= len(part.recoveries) - 1


@needs("gcc")
def test_in_the_same_storm_the_exported_c_says_what_python_says(storm):
    (answers,) = storm.compared(3000, 1, seed=7)
    assert (answers.samples, answers.differing) == (3000, 0)
    assert answers.away < 1e-8 * SPAN


def test_the_report_tells_of_every_part(storm, benchmark_module, tmp_path):
    wraps, report = benchmark_module("robustness.wraps"), benchmark_module("robustness.report")
    wrongs = [wraps.Wrong("Sarosi 2012", "mpc", n, False, 3.2, 0.1 * n, 0.1) for n in wraps.LENGTHS]
    report.write(wrongs, [*storm.driven(1000, 1, seed=3)], [storm.Compared(10, 0, 1e-6)], tmp_path)
    text = (tmp_path / "robustness.md").read_text()
    assert "| Sarosi 2012 | mpc | 0.10 | 0.10 | 0.30 | 2.00 |" in text
    assert "1000 samples" in text
    assert (tmp_path / "robustness.csv").read_text().count("\n") == 4
