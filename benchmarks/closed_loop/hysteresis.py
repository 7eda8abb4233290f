"""Benefit of identified hysteresis in the controllers' model.

`python -m benchmarks.closed_loop.hysteresis` runs the MPC on three trajectories and three plants: the standard one,
with Maxwell slip of separate springs and widths that grow with P1 + P2; the same with a Prandtl–Ishlinskii operator of
the angle; and the standard one without friction. The assumed hysteresis comes from a log of slow sweeps of the plant by
its sensors: opposed pressures with decreasing amplitudes at three co-contractions. The operator is identified from that
log by `fit_motion`, given the joint of the controllers' model. Three quarters or all of Dahl's friction are assumed
with the same loop width, as in the closed-loop benchmark, and with μ and δ fitted to the torque of the model's muscles
on the same log, up to a difference of strengths and a constant: the best possible model with one memory.

RMS error of the angle [°] before the load comes, and to the end with it, mean over the seeds; in brackets the standard
deviation.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from allocator.calculus import Array
from allocator.identification import fit_motion
from allocator.joint.hysteresis import PrandtlIshlinskii
from allocator.units import BAR, DEG
from benchmarks.closed_loop.cases import CASES, FREE, MODEL, SETTINGS, STANDARD, TOLD
from benchmarks.closed_loop.runs import figures, run_case
from mpc import RealPlant
from mpc.model.compensation import Compensation
from mpc.model.friction.contact import Hysteresis, Loads
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.trials.loops import loop

TRAJECTORIES = ("sine", "min-jerk", "chirp")
FIRST_SEED, SEEDS = 5001, 10
RESULT = Path(__file__).parents[1] / "results" / "hysteresis.md"
SWEEP = 8.0  # [s] from turn to turn
FILLED = (4.0, 5.0, 6.0)  # P1 + P2 [bar]
AVERAGED = 5  # samples of the log
_DT = 0.02  # [s]
_OPERATOR = PrandtlIshlinskii((0.4, 0.2, 0.2, 0.2), (1.5 * DEG, 3.5 * DEG, 7.0 * DEG), base=0.4)  # loops of 5°

PLANTS = {"Maxwell slip": STANDARD, "operator of the angle": replace(STANDARD, friction=_OPERATOR)}
VANISHED = "friction removed, Maxwell slip assumed"
TRACKED = PLANTS | {VANISHED: FREE}
DAHL, FITTED, OPERATOR = "Dahl", "Dahl, fitted", "operator"
SHARES = (0.75, 1.0)


class Log(NamedTuple):
    """Log of slow sweeps, averaged sensor readings."""

    t: Array  # (n,) [s]
    theta: Array  # (n,) [rad]
    P: Array  # (n, 2) [Pa]

    @property
    def x(self) -> Array:
        """States (4, n), as at rest."""
        return np.stack([self.theta, 0 * self.theta, *self.P.T])


def swept(real: RealPlant, seed: int = 0) -> Log:
    """Return the log of a plant with opposed pressures of decreasing amplitudes."""
    depths = np.array([0.0, 1.2, -1.2, 0.9, -0.8, 0.6, -0.5, 0.35, -0.25, 0.15, -0.1, 0.0])  # [bar]
    turns = SWEEP * np.arange(depths.size)
    t = np.arange(0.0, turns[-1], _DT)
    apart = np.interp(t, turns, depths)
    u = np.concatenate([np.stack([c / 2 + apart, c / 2 - apart], axis=1) for c in FILLED]) * BAR
    experiment = real.begin(_DT, real.at_rest(0.0, 5.5), seed)
    read = np.empty((len(u), 4))
    for k, command in enumerate(u):
        experiment.advance(command)
        read[k] = experiment.measure()
    settled = read[len(read) % AVERAGED :].reshape(-1, AVERAGED, 4).mean(axis=1)[round(2 / _DT / AVERAGED) :]
    return Log(AVERAGED * _DT * np.arange(len(settled)), settled[:, 0], settled[:, 2:])


def identified(log: Log) -> PrandtlIshlinskii:
    """Return the operator of the angle identified by `fit_motion`."""
    return fit_motion(log.t, log.theta, *log.P.T, joint=MODEL.joint).operator


def followed(friction: Hysteresis, log: Log) -> Array:
    """Return the memory of `friction` along the log (n, ...)."""
    memory, states = friction.begun(float(log.theta[0])), []
    for motion, x in zip(np.diff(log.theta, prepend=log.theta[:1]).tolist(), log.x.T.tolist(), strict=True):
        memory = friction.moved(memory, motion, Loads.of(MODEL, x))
        states.append(memory)
    return np.array(states)


def _without_muscles_error(log: Log, columns: Array) -> Array:
    """Return the residual of `columns` (n, …) after a difference of the muscles' strengths and a constant torque."""
    error = np.column_stack([MODEL.pull(log.x), np.ones_like(log.theta)])
    return np.asarray(columns - error @ np.linalg.lstsq(error, columns, rcond=None)[0])


def fitted_dahl(log: Log) -> Friction:
    """Return Dahl's friction with the μ and δ that best explain the log."""
    wanted = _without_muscles_error(log, MODEL.torque(log.x)[:, None])

    def explained(presliding: float) -> tuple[float, float]:
        z = followed(Friction(1.0, 0.0, presliding), log)
        column = _without_muscles_error(log, (MODEL.pull(log.x) * z)[:, None])
        mu = max(float(np.vdot(column, wanted) / np.vdot(column, column)), 0.0)
        return mu, float(((wanted - mu * column) ** 2).sum())

    best = minimize_scalar(lambda delta: explained(delta)[1], bounds=(0.1 * DEG, 10 * DEG), method="bounded").x
    return Friction(explained(float(best))[0], 0.0, float(best))


@cache
def told(plant: str) -> dict[tuple[str, float], Compensation]:
    """Return the controllers' assumptions by the model and its share."""
    logged = PLANTS["Maxwell slip" if plant == VANISHED else plant]
    log = swept(logged)
    models: dict[str, Hysteresis] = {
        DAHL: logged.friction.as_dahl(MODEL),
        FITTED: fitted_dahl(log),
        OPERATOR: MaxwellSlip.of(identified(log)),
    }
    shares = {(name, share): model.share(share) for name, model in models.items() for share in SHARES}
    shares |= {("nothing", 0.0): Friction()}
    return {key: replace(TOLD, friction=model) for key, model in shares.items()}


class Tracked(NamedTuple):
    """RMS errors [°] of a controller with these assumptions, by trajectory (trajectories, seeds)."""

    plant: str
    what: str
    share: float
    rms: Array
    loaded: Array


def tracked(plant: str, what: str, share: float, seeds: int = SEEDS, names: tuple[str, ...] = TRAJECTORIES) -> Tracked:
    """Run the MPC on one plant with one assumption."""
    driver = loop("mpc", SETTINGS._replace(compensation=told(plant)[what, share]))
    found = [
        [
            figures(name, run_case(TRACKED[plant], CASES[name], *driver, seed))
            for seed in range(FIRST_SEED, FIRST_SEED + seeds)
        ]
        for name in names
    ]
    rms, loaded = (np.array([[getattr(f, field) for f in row] for row in found]) for field in ("rms", "rms_with_load"))
    return Tracked(plant, what, share, rms, loaded)


def markdown(found: list[Tracked]) -> Iterator[str]:
    """Yield the report."""
    yield "# Hysteresis in the model\n\n" + (__doc__ or "").partition("\n\n")[2]
    for plant in dict.fromkeys(row.plant for row in found):
        yield f"\n## {plant}\n"
        models = told(plant)
        yield f"Assumed are {models[FITTED, 1.0].friction.summary}, δ = {_delta(models):.2g}°, if fitted, and"
        yield f"{models[OPERATOR, 1.0].friction.summary}: springs {_elements(models)}.\n"
        yield f"| assumed | {' | '.join(TRAJECTORIES)} | with load: {' | '.join(TRAJECTORIES)} |"
        yield "|---|" + "--:|" * 2 * len(TRAJECTORIES)
        rows = {(row.what, row.share): row for row in found if row.plant == plant}
        for (what, share), row in rows.items():
            cells = [f"{np.mean(r):.3f} ({np.std(r):.3f})" for r in (*row.rms, *row.loaded)]
            yield f"| {what}{f', {share:.0%}' if share else ''} | {' | '.join(cells)} |"
        for share in SHARES:
            gains = 1 - rows[OPERATOR, share].rms.mean(axis=1) / rows[DAHL, share].rms.mean(axis=1)
            yield f"\nThe operator against Dahl as wide, {share:.0%} of each: {_gains(gains)} less error."


def _gains(gains: Array) -> str:
    return ", ".join(f"{name} {gain:.0%}" for name, gain in zip(TRAJECTORIES, gains, strict=True))


def _delta(models: dict[tuple[str, float], Compensation]) -> float:
    friction = models[FITTED, 1.0].friction
    assert isinstance(friction, Friction)
    return friction.presliding / DEG


def _elements(models: dict[tuple[str, float], Compensation]) -> str:
    slip = models[OPERATOR, 1.0].friction
    assert isinstance(slip, MaxwellSlip)
    pairs = (f"{k:.2f} K of {r / DEG:.2g}°" for k, r in zip(slip.springs, slip.widths, strict=True))
    return f"{', '.join(pairs)}, {slip.base:.0%} of the widths without pressure"


def _job(job: tuple[str, str, float, int]) -> Tracked:
    return tracked(*job)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.closed_loop.hysteresis")
    parser.add_argument("--out", type=Path, default=RESULT)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    given = parser.parse_args()
    jobs = [(plant, *key, given.seeds) for plant in TRACKED for key in told(plant)]
    found = []
    with ProcessPoolExecutor(given.processes) as pool:
        for row in pool.map(_job, jobs):
            found.append(row)
            print(f"{row.plant}, {row.what} {row.share:.0%}: {row.rms.mean(axis=1)}", flush=True)
    text = "\n".join(markdown(found)) + "\n"
    given.out.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
