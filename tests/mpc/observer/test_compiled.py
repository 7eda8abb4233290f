"""The estimate in one compiled call is that of the readable observer, and leaves to it what is not ordinary."""

import pickle
import sys
import warnings
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.compilation import beside
from allocator.joint.hysteresis import PrandtlIshlinskii
from mpc import Compensation, KalmanObserver, RealPlant
from mpc.codegen.graphs import Untranslatable
from mpc.model.faults import (
    BrokenCable,
    DriftingSensor,
    FrozenSensors,
    Leak,
    SilentSensors,
    StuckValve,
    SupplyDrop,
    WrongReadings,
)
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.observer.compiled import module
from mpc.observer.filter import Belief
from mpc.observer.gating import Verdict

pytestmark = pytest.mark.compiles

DT = 0.01
REAL = RealPlant.standard()
MODEL, TOLD = REAL.nominal, REAL.known()
REST = REAL.at_rest(0.0, 5.5)
SEVERAL = "memories", "parts"  # of different lengths


def without_sizes(health):
    return [
        finding._replace(suspects=tuple(one._replace(size=0.0) for one in finding.suspects))
        for finding in health.findings
    ]


def sizes(health):
    return [one.size for finding in health.findings for one in finding.suspects]


class Pair:
    """An observer with compiled samples, and the same one that is readable."""

    def __init__(self, model=MODEL, **settings):
        self.compiled, self.readable = (KalmanObserver(model, DT, **settings) for _ in range(2))
        assert self.compiled.implementation == "compiled"
        self.readable.compiled = None
        self.taken = []  # whether the compiled sample answered

    def estimate(self, y, u):
        (x, d), (x_wanted, d_wanted) = (one.estimate(y, u) for one in (self.compiled, self.readable))
        self.taken.append(self.compiled.compiled.ahead)
        np.testing.assert_allclose(x, x_wanted, rtol=1e-9, atol=1e-11)
        assert d == pytest.approx(d_wanted, rel=1e-9, abs=1e-10)
        assert self.compiled.verdicts == self.readable.verdicts
        said, wanted = self.compiled.health, self.readable.health
        assert without_sizes(said) == without_sizes(wanted)
        assert sizes(said) == pytest.approx(sizes(wanted), rel=1e-9)
        return x, d

    def same(self):
        """All that is remembered is the same; `belief` hands it over."""
        one, other = self.compiled.belief, self.readable.belief
        np.testing.assert_allclose(one.xi, other.xi, rtol=1e-9, atol=1e-10)
        scale = np.sqrt(np.outer(*2 * [np.diag(other.covariance)]))
        np.testing.assert_allclose(one.covariance / scale, other.covariance / scale, atol=1e-9)
        left, right = (pair._remembered() for pair in (self.compiled, self.readable))
        assert (left is None) == (right is None)
        for name in () if left is None else set(left) - {"belief", "without", "samples"}:
            one, other = (
                np.concatenate([np.ravel(np.array(part, float)) for part in side[name]])
                if name in SEVERAL
                else np.array(side[name], float)
                for side in (left, right)
            )
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9, err_msg=name)


def swinging(k):
    """Commands that move the joint, with a rest in which an encoder repeats itself."""
    return REST[2:] + 0.9 * BAR * np.sin(k / 15) * np.array([1, -1]) * (k % 300 < 240)


def run(pair, real, samples, u=swinging, seed=1):
    experiment = real.begin(DT, REST, seed)
    for k in range(samples):
        pair.estimate(experiment.measure(), u(k - 1) if k else REST[2:])
        experiment.advance(u(k))
    return np.array(pair.taken)


KNOWN = {
    "all effects": TOLD,
    "Coulomb friction": Compensation(Friction(coulomb=0.2)),
    "dead time": Compensation(dead_time=0.03),
    "reading age": Compensation(dead_time=0.03, dead_band=0.1 * BAR, reading_age=0.04),
    "dead band": Compensation(dead_band=0.1 * BAR),
    "nothing": Compensation(),
    "Maxwell slip": Compensation(MaxwellSlip.of_width(MODEL, 4 * DEG), 0.02, 0.1 * BAR),
    "hysteresis of the angle": Compensation(PrandtlIshlinskii((0.7, 0.2, 0.1), (0.01, 0.03)), 0.0, 0.05 * BAR),
}


@pytest.mark.parametrize("known", KNOWN.values(), ids=KNOWN.keys())
def test_a_long_noisy_run_is_that_of_the_readable_observer(known):
    pair = Pair(compensation=known)
    taken = run(pair, REAL, 400)
    assert taken[3:].mean() > 0.98
    pair.same()


def test_so_it_is_where_pressures_change_no_faster_than_a_known_flow():
    pair = Pair(compensation=replace(TOLD, flow=2 * BAR))
    assert run(pair, replace(REAL, flow=2 * BAR), 400)[3:].mean() > 0.95
    pair.same()


@pytest.mark.slow
def test_so_it_is_with_gas_which_is_compiled_anew():
    model = replace(MODEL, gas=True)
    pair = Pair(model, compensation=TOLD)
    assert run(pair, replace(REAL, nominal=model), 400)[3:].mean() > 0.98
    pair.same()


@pytest.mark.parametrize("step", [0.1, 0.5])
def test_an_encoder_that_repeats_itself_is_ordinary(step):
    pair = Pair(compensation=TOLD)
    taken = run(pair, replace(REAL, encoder=step * DEG), 400)
    assert taken[4:].mean() > 0.95
    assert pair.compiled.encoder_step == pytest.approx(step * DEG)
    pair.same()


def test_rounding_is_no_step_of_an_encoder():
    pair, P = Pair(), np.array([2.0, 2.0]) * BAR
    for k in range(40):
        pair.estimate(np.array([0.1 * DEG * (k // 4) + 1e-12 * (-1) ** k, np.nan, *P]), P)
    assert pair.compiled.encoder_step == pair.readable.encoder_step == pytest.approx(0.1 * DEG)


FAULTS = {
    "leak": Leak(1.0, muscle=1),
    "leak that ends": Leak(1.0, 2.0, muscle=2),
    "stuck valve": StuckValve(1.0, muscle=2),
    "low supply": SupplyDrop(1.0, supply=2.0 * BAR),
    "broken cable": BrokenCable(1.0, muscle=1),
    "drifting sensor": DriftingSensor(1.0, sensor=2, rate=0.3 * BAR),
    "frozen angle": FrozenSensors(1.0, 2.0, sensors=(0,)),
    "frozen pressure": FrozenSensors(1.0, 2.0, sensors=(3,)),
    "silent pressure": SilentSensors(1.0, 2.0, sensors=(2,)),
    "a turn too many": WrongReadings(1.0, 2.0, (0,), 2 * np.pi, added=True),
    "lost zero": WrongReadings(1.0, 9.0, (0,), 10 * DEG, added=True),
}


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS.keys())
def test_whatever_is_broken_verdicts_and_health_are_those_of_the_readable_observer(fault):
    pair, said = Pair(compensation=TOLD), set()
    experiment = replace(REAL, faults=(fault,)).begin(DT, REST, 3)
    for k in range(350):
        pair.estimate(experiment.measure(), swinging(k - 1) if k else REST[2:])
        experiment.advance(swinging(k))
        said.add(str(pair.compiled.health))
    taken = np.array(pair.taken)
    assert taken[3:100].all()
    assert taken[100:].any()
    assert len(said) > 1 or not isinstance(fault, Leak | StuckValve | SupplyDrop | BrokenCable | FrozenSensors)
    pair.same()


@pytest.mark.parametrize("sensor", [0, 2])
def test_a_sensor_that_sticks_in_slow_motion_is_doubted_at_the_same_sample(sensor):
    pair = Pair(compensation=TOLD)
    real = replace(REAL, faults=(FrozenSensors(1.0, 9.0, sensors=(sensor,)),))
    taken = run(pair, real, 300, lambda k: REST[2:] + 0.2 * BAR * k / 100 * np.array([1, -1]))
    assert pair.compiled.verdicts[[0, 2].index(sensor)] is Verdict.FROZEN
    assert taken[100:112].all()
    assert not taken[-1]


NOT_ORDINARY = {
    "no angle": ([np.nan, np.nan, *REST[2:]], REST[2:]),
    "no pressure": ([0.0, np.nan, np.nan, REST[3]], REST[2:]),
    "an angle that cannot be": ([1e300, np.nan, *REST[2:]], REST[2:]),
    "a pressure that is too high": ([0.0, np.nan, 9 * BAR, REST[3]], REST[2:]),
    "a jump": ([0.3, np.nan, *REST[2:]], REST[2:]),
    "a command that is none": ([0.0, np.nan, *REST[2:]], [np.nan, REST[3]]),
    "a command beyond the supply": ([0.0, np.nan, *REST[2:]], [9 * BAR, REST[3]]),
}


@pytest.mark.parametrize("case", NOT_ORDINARY.values(), ids=NOT_ORDINARY.keys())
def test_what_is_not_ordinary_the_readable_parts_answer_and_give_back(case):
    pair, rng = Pair(compensation=TOLD), np.random.default_rng(2)
    noise = np.array([0.01 * DEG, 0.0, 0.02 * BAR, 0.02 * BAR])
    for k in range(60):
        y, u = case if k in (20, 25, 26) else (REST + noise * rng.normal(size=4), REST[2:])
        pair.estimate(np.array(y), np.array(u))
    taken = np.array(pair.taken)
    assert taken[3:20].all()
    assert not taken[[20, 25, 26]].any()
    assert taken[-5:].all()
    pair.same()


def spoilt(y, previous, rng):
    """Readings `y` (4,) of which something is wrong."""
    j, noise = rng.choice([0, 2, 3]), rng.normal()
    wrong = y.copy()
    match rng.integers(6):
        case 0:
            wrong[j] = rng.choice([np.nan, np.inf, 1e300, -3.0])
        case 1:
            wrong[0] += 2 * np.pi * rng.integers(-3, 4)
        case 2:
            wrong[j] += noise * (0.2 if j == 0 else BAR)
        case 3:
            wrong[j] += noise * (2 * DEG if j == 0 else 0.1 * BAR)
        case 4:
            wrong[j] = previous[j]
        case 5:
            wrong = previous.copy()
    return wrong


@pytest.mark.parametrize(("share", "tolerance", "encoder"), [(0.02, 0.1, 0.1), (0.2, 0.05, 0.02), (0.5, 0.0, 0.5)])
def test_whatever_the_sensors_say_the_answers_are_those_of_the_readable_observer(share, tolerance, encoder):
    pair, rng = Pair(compensation=TOLD, tolerance=tolerance), np.random.default_rng(5)
    experiment, u = replace(REAL, encoder=encoder * DEG).begin(DT, REST, 5), REST[2:]
    y = previous = experiment.measure()
    for k in range(600):
        if 300 <= k < 330:  # it sticks
            y[0] = previous[0]
        elif rng.random() < share:
            y = spoilt(y, previous, rng)
        pair.estimate(y, u)
        u, previous = swinging(k) * (np.nan if rng.random() < 0.1 * share else 1.0), y
        experiment.advance(swinging(k))
        y = experiment.measure()
    assert 0.1 < np.mean(pair.taken) < 1.0
    pair.same()


def test_numbers_of_any_type_are_the_same_question():
    pair = Pair(compensation=TOLD)
    for k in range(20):
        y = np.round([1e-4 * k, 0.0, REST[2] + k % 5, REST[3] - k % 7], 6)
        pair.estimate(y, REST[2:])
        pair.estimate(y.tolist(), list(REST[2:]))
        pair.estimate(np.stack([y, y]).T[:, 0], np.repeat(REST[2:], 2)[::2])
    assert all(pair.taken[4:])
    for wrong in (REST[:2], 0.0, None):
        with pytest.raises((IndexError, TypeError, ValueError)):
            pair.compiled.estimate(wrong, REST[2:])
    pair.estimate(REST, REST[2:])


def test_whoever_looks_at_the_belief_or_sets_it_goes_on_with_it():
    pair = Pair(compensation=TOLD)
    run(pair, REAL, 50)
    assert pair.compiled.verdicts == [Verdict.BELIEVED] * 3
    for one in (pair.compiled, pair.readable):
        one.belief.xi[4] += 0.5  # in place
    run(pair, REAL, 5)
    for one in (pair.compiled, pair.readable):
        one.belief = Belief(np.append(REST, 1.0), 2 * one.filter.stationary)
    pair.same()
    run(pair, REAL, 50)
    pair.same()


def test_copies_and_a_reset_go_on_as_the_readable_observer_does():
    pair = Pair(compensation=TOLD)
    run(pair, REAL, 30)
    before = pair.compiled
    pair.compiled, pair.readable = deepcopy(pair.compiled), deepcopy(pair.readable)
    pair.readable.compiled = None
    run(pair, REAL, 30)
    assert before.belief.xi[0] != pair.compiled.belief.xi[0]
    pair.compiled = pickle.loads(pickle.dumps(pair.compiled))
    run(pair, REAL, 30)
    pair.compiled.reset(), pair.readable.reset()
    assert pair.compiled.belief is None
    assert pair.compiled.verdicts == [Verdict.SILENT] * 3
    run(pair, REAL, 30)
    pair.same()


def test_without_a_compiler_the_readable_observer_answers_and_nobody_is_warned(monkeypatch):
    monkeypatch.setitem(sys.modules, "mpc.observer.compiled.module", None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        observer = KalmanObserver(MODEL, DT)
    assert observer.implementation == "readable"
    assert np.isfinite(observer.estimate(REST, REST[2:])[0]).all()


def test_friction_of_an_own_kind_is_left_to_the_readable_observer():
    class Own(Friction):
        """A friction that compiled code does not know."""

    assert KalmanObserver(MODEL, DT, compensation=Compensation(Own(mu=0.1))).implementation == "readable"


def test_formulas_that_are_too_long_are_left_to_the_readable_observer(monkeypatch):
    def too_long(own):
        raise Untranslatable("too long")

    monkeypatch.setattr(module, "compiled_filter", too_long)
    assert KalmanObserver(MODEL, DT).implementation == "readable"


def test_who_does_not_wait_gets_the_readable_observer_and_another_process_compiles(monkeypatch):
    def not_kept(*_):
        raise beside.NotKept

    begun = []
    monkeypatch.setattr(beside, "begin", lambda *arguments: begun.append(arguments) or True)
    monkeypatch.setattr("mpc.observer.compiled.factory.CompiledEstimate", not_kept)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        observer = KalmanObserver(MODEL, DT, compensation=TOLD, wait=False)
    assert observer.implementation == "readable"
    [(name, directory, work, *arguments)] = begun
    assert (directory / f"{name}.py").exists()
    assert (work, arguments) == (KalmanObserver, [MODEL, DT, observer.noise, TOLD])


def test_observers_that_differ_in_numbers_and_friction_share_what_is_compiled():
    one = KalmanObserver(MODEL, DT, compensation=TOLD)
    for told in (Compensation(dead_time=0.04), KNOWN["Maxwell slip"]):
        other = KalmanObserver(replace(MODEL, inertia=0.07), 0.02, compensation=told)
        assert one.compiled.module is other.compiled.module
