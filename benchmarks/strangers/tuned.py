"""Tuning of each controller for the model of a stranger: the same tool, draws and budget for all, kept per stranger.

A tuning is kept as TOML in `benchmarks/results/strangers_tuning/`, under a name that changes with the model and the
budget; the file is empty if the defaults stay. It sees the model alone, never the stranger.
"""

from hashlib import sha256
from pathlib import Path

from allocator.files.atomic import write_text
from mpc import tune
from mpc.trials.loops import Settings, robust
from mpc.trials.motions.reference import Reference
from mpc.trials.tuned import TUNABLE, Tuning
from mpc.tuning.draws import Spreads

EVALUATIONS, DRAWS, SEED = 30, 6, 0
KEPT = Path(__file__).parents[1] / "results" / "strangers_tuning"


def tuned(
    name: str, controller: str, settings: Settings, spreads: Spreads, K: float, reference: Reference
) -> Settings:  # fmt: skip
    """Return the settings tuned for the model of the stranger called `name`; those for the `reference` if the defaults
    stay, or if there is nothing to tune.

    A kept tuning is taken; any other is made now.
    """
    usual = robust(controller, settings, reference)
    if controller not in TUNABLE:
        return usual
    known = settings.plant, settings.compensation, spreads, K
    digest = sha256(repr((*known, EVALUATIONS, DRAWS, SEED)).encode()).hexdigest()[:12]
    path = KEPT / f"{name}-{controller}-{digest}.toml"
    if not path.exists():
        found = tune(
            settings.plant, settings.compensation, controller=controller, spreads=spreads, K=K,
            evaluations=EVALUATIONS, n_draws=DRAWS, seed=SEED, dt=settings.dt, horizon=settings.N,
        )  # fmt: skip
        write_text(path, "" if found.stays else "\n".join(found.tuning.lines()) + "\n")
    tuning = Tuning.load(path)
    return usual if tuning is None else tuning.applied(usual)
