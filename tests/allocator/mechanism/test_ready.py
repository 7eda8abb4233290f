"""Compiled answers, against the readable road: every field, every limit, every refusal."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from allocator import InvalidInput, Limits, Stiffness, allocate, warm_up
from allocator.allocation.box import ready
from allocator.allocation.box.kernel.target import answers
from allocator.compilation import beside
from allocator.mechanism import Mechanism, Tables, from_function, machines
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N
from allocator.units import BAR

from ...rigs.two_links import two_links


def compiled(found):
    """Whether compiled code gave the answer."""
    return isinstance(vars(found)["_later"], ready.Later)


def by_function():
    """One joint and two muscles whose lengths are a formula of ours, without end stops."""
    routes = from_function(0.4, 1, lambda q: [0.345 - 0.02 * q[0], 0.345 + 0.02 * q[0] + 0.002 * q[0] ** 2])
    return Mechanism(routes, (SAROSI_DMSP_20_400N,) * 2)


MACHINES = {"arm26": machines.arm26(), "leg37": machines.leg37(), "sites": two_links(), "formula": by_function()}
LIMITS = {
    "taut": {},
    "slack": {"min_force": None},
    "ceilings": {"min_force": 40.0, "max_force": 350.0},
    "nearest": {"previous": ...},
    "slew": {"previous": ..., "max_step": 0.3 * BAR},
}
FIELDS = (
    *("T", "K", "torque_met", "stiffness_met", "holds", "kkt_residual", "gap", "lower_bounds", "q", "theta"),
    *("T_target", "K_target", "T_error", "K_error", "forces", "isobaric_stiffness", "costs", "least_stiffness"),
    *("separation", "box", "active", "broken", "message", "assumed", "_mu"),
)


@pytest.fixture(params=MACHINES.values(), ids=MACHINES.keys())
def mechanism(request, monkeypatch):
    """A mechanism that is ready, its kernel as plain Python."""
    monkeypatch.setattr(ready, "_compiled", lambda: answers)
    monkeypatch.setattr(ready, "_ready", {})
    assert ready.warm_up(request.param)
    return request.param


def questions(mechanism, count, limits):
    """Yield targets within reach and beyond it, at postures within the ranges and beyond them, under `limits`."""
    rng = np.random.default_rng(5)
    for k in range(count):
        q = rng.uniform(-0.6, 0.6, mechanism.n)
        P = rng.uniform(*mechanism.pressure_box(mechanism.within(q)))
        K = mechanism.stiffness(q, P) * (1.0, 1.6)[k % 2]
        K = K if np.linalg.eigvalsh(K)[0] > 0.05 else np.eye(mechanism.n) * 3.0
        T = mechanism.torque(q, P) * (1.0, 1.0, 4.0)[k % 3]
        now = np.clip(P + rng.uniform(-1, 1, mechanism.m) * BAR, 0.0, 5 * BAR)
        given = {name: now if value is ... else value for name, value in limits.items()}
        yield q, (K, np.diagonal(K), 5.0)[k % 5 % 3], T if k % 4 else 0.0, Limits(**given)


def same(one, other, rel=1e-9):
    """Insist that two values are the same, up to rounding."""
    if isinstance(one, tuple) and not isinstance(one, str) and any(isinstance(x, np.ndarray) for x in one):
        for a, b in zip(one, other, strict=True):
            same(a, b, rel)
    elif isinstance(one, str | tuple | bool):
        assert one == other
    elif np.asarray(one).dtype == object:  # of names
        assert one.tolist() == other.tolist()
    else:
        assert np.shape(one) == np.shape(other)
        scale = max(float(np.abs(np.nan_to_num(other)).max(initial=0.0)), 1.0)
        assert np.asarray(one, float) == pytest.approx(np.asarray(other, float), rel=rel, abs=1e-9 * scale, nan_ok=True)


@pytest.mark.parametrize("limits", LIMITS.values(), ids=LIMITS.keys())
def test_every_field_is_that_of_the_readable_road(mechanism, limits, monkeypatch):
    met = set()
    for k, (*targets, kept) in enumerate(questions(mechanism, 12, limits)):
        priority = ("torque", "stiffness")[k // 2 % 2]
        found = allocate(*targets, joint=mechanism, limits=kept, priority=priority)
        assert compiled(found)
        with monkeypatch.context() as patch:
            patch.setattr(ready, "_ready", {})
            readable = allocate(*targets, joint=mechanism, limits=kept, priority=priority)
        assert not compiled(readable)
        assert found.P == pytest.approx(readable.P, abs=1e-9 * 5 * BAR)
        assert found.status is readable.status
        assert found.kkt_residual < 1e-9
        for name in FIELDS:
            same(getattr(found, name), getattr(readable, name))
        met.add(found.status)
    assert len(met) > 1


def test_targets_with_leading_axes_of_one_keep_them(mechanism):
    n, m = mechanism.n, mechanism.m
    q, K, T = np.full(n, 0.1), np.eye(n) * 6.0, np.zeros(n)
    one = allocate(q, K, T, joint=mechanism)
    for lead in ((1,), (1, 1)):
        many = allocate(q.reshape(*lead, n), K.reshape(*lead, n, n), T.reshape(*lead, n), joint=mechanism)
        assert compiled(many)
        assert many.P.shape == (*lead, m)
        assert many.K.shape == (*lead, n, n)
        assert many.status.shape == many.kkt_residual.shape == lead
        assert many.P.ravel().tolist() == one.P.tolist()


@pytest.mark.parametrize("limits", LIMITS.values(), ids=LIMITS.keys())
@pytest.mark.parametrize(("diagonal", "lead"), [(False, (12,)), (True, (2, 6))])
def test_every_field_of_many_targets_is_that_of_the_readable_road(mechanism, limits, diagonal, lead, monkeypatch):
    n, m = mechanism.n, mechanism.m
    q, K, T, kept = zip(*questions(mechanism, 12, limits), strict=True)
    K = [np.diag(np.full(n, one)) if np.ndim(one) == 0 else one if np.ndim(one) == 2 else np.diag(one) for one in K]
    K = np.array([np.diag(one) for one in K]).reshape(*lead, n) if diagonal else np.array(K).reshape(*lead, n, n)
    q, T = np.reshape(q, (*lead, n)), np.array([np.broadcast_to(one, n) for one in T]).reshape(*lead, n)
    if kept[0].previous is not None:
        now = np.array([one.previous for one in kept]).reshape(*lead, m)
        kept = [kept[0]._replace(previous=now)]
    found = allocate(q, K, T, joint=mechanism, limits=kept[0])
    assert compiled(found)
    monkeypatch.setattr(ready, "_ready", {})
    readable = allocate(q, K, T, joint=mechanism, limits=kept[0])
    assert not compiled(readable)
    assert found.P == pytest.approx(readable.P, abs=1e-9 * 5 * BAR)
    assert found.status.tolist() == readable.status.tolist()
    assert found.P.shape == (*lead, m)
    for name in FIELDS:
        same(getattr(found, name), getattr(readable, name))


def test_more_targets_than_pay_and_none_go_the_readable_road(mechanism):
    K, limits = np.ones(mechanism.n), Limits()
    for N in (0, ready.MOST + 1):
        assert ready.answered(mechanism, np.zeros((N, mechanism.n)), K, 0.0, "torque", limits) is None


def test_compilation_begins_in_another_process_only_if_nothing_is_kept(monkeypatch):
    kept, begun, arm = [], [], machines.arm26()
    monkeypatch.setattr(ready, "_compiled", lambda: SimpleNamespace(_cache=SimpleNamespace(cache_path="kept")))
    monkeypatch.setattr(ready, "warm_up", lambda mechanism: kept or beside.check_may_compile("answers"))
    monkeypatch.setattr(beside, "begin", lambda *arguments: begun.append(arguments))
    ready.begin_warm_up(arm)
    assert begun == [("ready", Path("kept"), ready.warm_up, arm)]
    kept.append(True)
    ready.begin_warm_up(arm)
    assert len(begun) == 1


def test_an_answer_stays_when_the_arrays_it_was_asked_with_change(mechanism):
    n = mechanism.n
    q, K, T, now = np.full(n, 0.1), np.eye(n) * 6.0, np.ones(n), np.full(mechanism.m, 2 * BAR)
    found = allocate(q, K, T, joint=mechanism, limits=Limits(previous=now, max_step=BAR))
    P = found.P.copy()
    for array in (q, K, T, now):
        array[...] = 7.0
    allocate(np.full(n, 0.2), np.eye(n) * 9.0, joint=mechanism)
    assert found.P.tolist() == P.tolist()
    assert found.theta == pytest.approx(np.full(n, 0.1))
    assert found.T_target == pytest.approx(np.ones(n))
    assert found.box[1].max() <= 3 * BAR + 1e-6
    with pytest.raises(ValueError, match="read-only"):
        found.P[0] = 0.0


def test_an_endpoint_gas_and_other_methods_go_the_readable_road():
    arm = machines.arm26()
    q, K = [0.4, -0.3], [[10.0, 4.0], [4.0, 9.0]]
    shut = replace(arm, muscles=tuple(replace(muscle, rest_volume=1.2e-4) for muscle in arm.muscles))
    assert ready.answered(arm, q, K, 0.0, "torque", Limits()) is None  # nobody has made it ready
    assert allocate(q, K, joint=shut, stiffness=Stiffness("shut")).kind.name == "shut"


ODD = [
    ({"theta": [40.0, 3.0]}, "over a turn"),
    ({"theta": [0.4, np.nan]}, "not finite"),
    ({"theta": [0.4]}, "expected"),
    ({"theta": [[0.4], [0.3]]}, "expected"),
    ({"theta": ["a", "b"]}, "numbers"),
    ({"theta": [[0.4], [0.1, 0.2]]}, "numbers"),
    ({"K": [[10.0, 4.0], [3.0, 9.0]]}, "not symmetric"),
    ({"K": [[1.0, 4.0], [4.0, 1.0]]}, "positive definite"),
    ({"K": -3.0}, "positive"),
    ({"K": [True, True]}, "numbers"),
    ({"T": [1.0, np.inf]}, "not finite"),
    ({"T": [1.0, 2.0, 3.0]}, "expected"),
    ({"limits": Limits(min_force=-1.0)}, "not negative"),
    ({"limits": Limits(min_force=50.0, max_force=20.0)}, "exceed"),
    ({"limits": Limits(previous=[3.0] * 6)}, "bar"),
    ({"limits": Limits(previous=[3e5] * 6, max_step=0.3)}, "bar"),
    ({"limits": Limits(max_step=0.3 * BAR)}, "previous"),
    ({"limits": Limits(min_cocontraction=1e5)}, "min_cocontraction"),
    ({"priority": "speed"}, "priority"),
]


@pytest.mark.parametrize(("changed", "sentence"), ODD, ids=[f"{value}" for value, _ in ODD])
def test_wrong_input_is_refused_by_the_same_sentence(changed, sentence, monkeypatch):
    arm = machines.arm26()
    asked = {"theta": [0.4, -0.3], "K": [[10.0, 4.0], [4.0, 9.0]], "T": [9.0, 4.0], "joint": arm} | changed
    with pytest.raises(InvalidInput, match=sentence) as readable:
        allocate(**asked)
    monkeypatch.setattr(ready, "_compiled", lambda: answers)
    monkeypatch.setattr(ready, "_ready", {})
    assert ready.warm_up(arm)
    with pytest.raises(InvalidInput) as refused:
        allocate(**asked)
    assert str(refused.value) == str(readable.value)


def test_routes_without_formulas_and_curved_muscles_are_not_made_ready(monkeypatch):
    monkeypatch.setattr(ready, "_compiled", lambda: answers)
    monkeypatch.setattr(ready, "_ready", {})
    table = Tables(0.4, [np.linspace(-1, 1, 9)], 0.345 + 0.02 * np.linspace(-1, 1, 9)[:, None] * [-1, 1])
    assert not ready.warm_up(Mechanism(table, (SAROSI_DMSP_20_400N,) * 2))
    assert not ready.warm_up(replace(machines.arm26(), muscles=(TONDU_DMSP_20_400N,) * 6))


@pytest.mark.compiles
def test_compiled_code_gives_the_digits_of_plain_python(monkeypatch):
    arm = two_links()
    assert warm_up(joint=arm)
    asked = list(questions(arm, 40, LIMITS["slew"]))
    compiled = [allocate(*targets, joint=arm, limits=kept) for *targets, kept in asked]
    monkeypatch.setattr(ready, "_compiled", lambda: answers)
    monkeypatch.setattr(ready, "_ready", {})
    assert ready.warm_up(arm)
    for a, (*targets, kept) in zip(compiled, asked, strict=True):
        b = allocate(*targets, joint=arm, limits=kept)
        assert a.P == pytest.approx(b.P, abs=1e-9 * 5 * BAR)
        assert a.status is b.status
    assert len({a.status for a in compiled}) > 2
