"""The constants of a braid are computed once for a muscle, and anew for a muscle of other parameters."""

import pickle
from dataclasses import replace
from unittest.mock import Mock

import casadi as ca
import numpy as np
import pytest

from allocator import Stiffness, allocate, report_joint
from allocator.muscles.catalogue import TONDU_DMSP_20_400N
from allocator.muscles.models import mckibben


@pytest.fixture
def counted(monkeypatch):
    """`braid_constants`, as muscles call it; `call_count` says how often it was."""
    counted = Mock(side_effect=mckibben.braid_constants)
    monkeypatch.setattr(mckibben, "braid_constants", counted)
    return counted


@pytest.mark.parametrize(
    "options",
    [{}, {"method": "qp"}, {"priority": "weighted", "weights": (1.0, 1.0)}, {"stiffness": Stiffness(tolerance=0.1)}],
    ids=repr,
)
def test_three_targets_take_one_evaluation_and_three_more_take_none(counted, options):
    joint = report_joint.__wrapped__(replace(TONDU_DMSP_20_400N))
    for _ in range(2):
        a = allocate(np.array([-0.5, 0.0, 0.5]), 7.5, 1.0, joint=joint, **options)
        assert a.jacobian().shape == (3, 2, 3)
        assert counted.call_count == 1


def test_a_muscle_of_other_parameters_has_other_constants(counted):
    muscle = replace(TONDU_DMSP_20_400N)
    known = muscle.a, muscle.b, muscle.S
    other = muscle.with_parameters({"alpha0": 0.5, "r0": 0.02})
    assert (other.a, other.b) == mckibben.braid_constants(0.5)
    assert other.S == pytest.approx(np.pi * 0.02**2, rel=1e-15)
    assert (muscle.a, muscle.b, muscle.S) == known


def test_constants_of_symbols_are_symbols():
    muscle = replace(TONDU_DMSP_20_400N)
    known = muscle.a, muscle.b, muscle.S
    p = ca.SX.sym("p", len(muscle.parameters))
    symbolic = muscle.unchecked(ca.vertsplit(p))
    f = ca.Function("f", [p], [symbolic.a, symbolic.b, symbolic.S, symbolic.law(3e5, 0.1)])
    values = list(muscle.parameters.values())
    assert [float(x) for x in f(values)] == pytest.approx([*known, muscle.law(3e5, 0.1)], rel=1e-12)
    alpha0 = list(muscle.parameters).index("alpha0")
    assert float(f([*values[:alpha0], 0.5, *values[alpha0 + 1 :]])[0]) == pytest.approx(3 / np.tan(0.5) ** 2, rel=1e-12)
    assert (muscle.a, muscle.b, muscle.S) == known


def test_a_muscle_stays_the_same_value_once_its_constants_are_known():
    muscle, fresh = replace(TONDU_DMSP_20_400N), replace(TONDU_DMSP_20_400N)
    assert muscle.a > muscle.b
    assert muscle == fresh
    assert hash(muscle) == hash(fresh)
    assert repr(muscle) == repr(fresh)
    same = pickle.loads(pickle.dumps(muscle))
    assert same == muscle
    assert (same.a, same.b, same.S) == (muscle.a, muscle.b, muscle.S)
    with pytest.raises(AttributeError):
        muscle.a = 1.0
