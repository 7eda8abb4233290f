"""Controllers tuned for the model of a stranger: results that are kept, and the worth of a tuning on unseen draws."""

from dataclasses import replace

import pytest

from benchmarks.strangers import tuned as kept
from benchmarks.strangers.identified import data_sheet
from benchmarks.strangers.plants import TUNING, drawn
from benchmarks.strangers.runs import CASES
from mpc import tune
from mpc.trials.loops import Settings
from mpc.trials.tuned import Tuning
from mpc.tuning.draws import Spreads, draws, payloads

K = 5.0
REFERENCE = CASES["sine"].reference


@pytest.fixture(scope="module")
def model():
    return data_sheet(drawn("tips", TUNING + 1))


def test_a_tuning_that_is_kept_is_taken_for_the_same_model_alone(model, tmp_path, monkeypatch):
    asked = []

    class Found:
        stays = False

        def __init__(self, settings, controller):
            start = Tuning.start(controller, settings)
            self.tuning = Tuning(controller, {name: 0.9 * value for name, value in start.numbers.items()})

    def tuned(plant, told, *, controller, **_):
        asked.append(controller)
        return Found(Settings(plant, compensation=told), controller)

    monkeypatch.setattr(kept, "KEPT", tmp_path)
    monkeypatch.setattr(kept, "tune", tuned)
    settings = Settings(model.plant, compensation=model.told)
    first, second = (kept.tuned("tips-1001", "pid", settings, Spreads(), K, REFERENCE) for _ in range(2))
    assert first.gains == second.gains
    assert asked == ["pid"]
    assert first.gains.proportional == pytest.approx(0.9 * 2.26)
    heavier = settings._replace(plant=replace(model.plant, inertia=2 * model.plant.inertia))
    kept.tuned("tips-1001", "pid", heavier, Spreads(), K, REFERENCE)
    assert asked == ["pid", "pid"]
    assert kept.tuned("tips-1001", "feedforward", settings, Spreads(), K, REFERENCE) == settings
    Found.stays = True
    assert kept.tuned("tips-1002", "pid", settings, Spreads(), K, REFERENCE) == settings
    assert kept.tuned("tips-1002", "pid", settings, Spreads(), K, REFERENCE) == settings
    assert asked == ["pid", "pid", "pid"]


@pytest.mark.slow
@pytest.mark.compiles
def test_a_tuning_is_better_than_the_defaults_on_draws_that_it_has_not_seen(model):
    found = tune(model.plant, model.told, K=K, evaluations=6, n_draws=3)
    n, seed, spreads = 6, 77, Spreads()
    unseen = replace(
        found.problem,
        draws=draws(model.plant, model.told, n, seed, spreads),
        payloads=payloads(n, seed, K, spreads),
        seed=seed,
        key="unseen",
    )
    before, after = (unseen.evaluated(one.tuning, always=True) for one in (found.before, found.after))
    assert after.objective < before.objective
