"""Branches of rising and falling pressure are told apart, and their difference is named."""

from dataclasses import replace

import numpy as np
import pytest

from allocator.errors import InvalidFile
from allocator.identification import load_dataset
from allocator.identification.muscle.fit import prepared
from allocator.identification.muscle.load_cell import hysteresis
from allocator.identification.muscle.reading import read_samples
from allocator.identification.muscle.samples import Samples
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR

FRICTION = 0.015  # of the force, on either side


def loops(moving, rng, rows=40):
    """Triangular sweeps of one quantity at five levels of the other; friction as of threads: it opposes the motion."""
    up = np.concatenate([np.linspace(0, 1, rows), np.linspace(1, 0, rows)])
    sign = np.concatenate([np.ones(rows), -np.ones(rows)])
    levels = np.linspace(0.1, 0.9, 5)
    swept, level, s = np.tile(up, 5), np.repeat(levels, 2 * rows), np.tile(sign, 5)
    share = {"pressure": (level, swept), "contraction": (swept, level)}[moving]
    eps, P = 0.15 * share[0], (1 + 4 * share[1]) * BAR
    F = SAROSI_DMSP_20_400N.force(P, eps)
    shortening = s  # pressure that rises shortens the threads, contraction that rises does
    return eps, P, F * (1 - FRICTION * shortening) + rng.normal(0, 3.0, F.size), s


@pytest.mark.parametrize("moving", ["pressure", "contraction"])
def test_the_order_of_the_rows_tells_the_branches(moving):
    eps, P, F, _ = loops(moving, np.random.default_rng(2))
    (found,) = hysteresis(Samples.checked(eps, P, F))
    assert found.quantity == moving
    assert found.percent == pytest.approx(100 * 2 * FRICTION, rel=0.15)
    assert abs(found.difference - 2 * FRICTION * F.mean()) < 4 * found.std


def test_rows_in_any_order_show_it_only_with_a_column_of_directions():
    rng = np.random.default_rng(5)
    eps, P, F, s = loops("pressure", rng)
    order = rng.permutation(F.size)
    shuffled = Samples.checked(eps[order], P[order], F[order])
    assert hysteresis(shuffled) == ()
    (found,) = hysteresis(replace(shuffled, direction=s[order]))
    assert found.percent == pytest.approx(100 * 2 * FRICTION, rel=0.15)


@pytest.mark.parametrize("table", ["dmsp-20-300-map", "dmsp-20-sheet"])
def test_a_table_without_branches_has_none(table):
    assert hysteresis(load_dataset(table)) == ()


def test_a_muscle_without_friction_has_none():
    eps, P, _, _ = loops("pressure", np.random.default_rng(2))
    F = SAROSI_DMSP_20_400N.force(P, eps) + np.random.default_rng(7).normal(0, 3.0, eps.size)
    assert hysteresis(Samples.checked(eps, P, F)) == ()


def test_a_long_log_names_it_before_its_rows_are_averaged():
    eps, P, F, _ = loops("pressure", np.random.default_rng(4), rows=400)
    samples = prepared(Samples.checked(eps, P, F))
    assert samples.n < F.size
    assert any("hysteresis" in note and "falling pressure" in note for note in samples.notes)


def test_directions_are_read_in_words_and_numbers(tmp_path):
    path = tmp_path / "f.csv"
    rows = "eps [%],p [bar],F [N],Richtung\n5,1,100,{}\n5,2,200,{}\n5,3,300,{}\n"
    for words in (("auf", "ab", "steigend"), ("inflating", "deflating", "inflating"), (1, -1, 1)):
        path.write_text(rows.format(*words), encoding="utf-8")
        assert read_samples(path).direction.tolist() == [1.0, -1.0, 1.0]
    path.write_text(rows.format("auf", "sideways", "ab"), encoding="utf-8")
    with pytest.raises(InvalidFile, match="sideways"):
        read_samples(path)
    path.write_text("eps [%],p [bar],F [N]\n5,1,100\n5,2,200\n", encoding="utf-8")
    assert read_samples(path).direction is None
