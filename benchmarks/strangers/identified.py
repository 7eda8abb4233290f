"""Identification of a stranger from simulated logs: slow sweeps for `fit_joint`, random steps for `fit_motion`."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from allocator import BAR, Pulley
from allocator.calculus import Array
from allocator.identification import fit_joint, fit_motion
from benchmarks.strangers.plants import LENGTH, LEVER, MIDDLE, Stranger
from mpc import Compensation, Plant
from mpc.identification.plant import IdentifiedPlant
from mpc.tuning.draws import Spreads

DT = 0.01  # [s]
DWELL, SHOWN = 1.2, 0.2  # [s] at each pair of pressures, of which the last are read
HELD = np.arange(1.25, 4.3, 0.75) * BAR
WEIGHTS = (-1.5, 0.0, 1.5, 0.0)  # [N·m] hung on and taken off, so that hysteresis is traversed each time
SECONDS = 90.0  # of random steps


class Model(NamedTuple):
    """Model of a controller and its observer."""

    plant: Plant
    told: Compensation
    spreads: Spreads = Spreads()  # of real plants about it
    tuned: bool = False  # whether each controller is tuned for it


def data_sheet(stranger: Stranger) -> Model:
    """Return the model from data sheets."""
    return Model(stranger.nominal, stranger.told)


def identified(stranger: Stranger) -> Model:
    """Return the model that `fit_joint` and `fit_motion` find, read from the file that they write."""
    columns = swept(stranger)
    joint = fit_joint(
        columns["theta"], columns["P1"], columns["P2"], geometry=Pulley(LENGTH, LEVER, MIDDLE),
        torque=columns["torque"], direction=columns["direction"], leave_one_out=False, choices=False,
    ).joint  # fmt: skip
    t, x = moved(stranger)
    theta, P1, P2, *measured = x.T
    fit = fit_motion(t, theta, P1, P2, joint=joint, measured=(measured[0], measured[1]))
    with TemporaryDirectory() as directory:
        path = Path(directory) / "plant.toml"
        IdentifiedPlant.of(fit, {"slew": stranger.nominal.slew}).save(path)
        return Model(Plant.load(path), Compensation.load(path), Spreads.load(path))


def swept(stranger: Stranger) -> dict[str, Array]:
    """Return the rests of slow sweeps up and down: one pressure held, the other stepped; and of weights hung on it."""
    stops = [(P1, P2, 0.0, s) for P1 in HELD for s, path in ((-1, HELD), (1, HELD[::-1])) for P2 in path]
    turns = (0.0, *np.sign(np.diff(WEIGHTS, prepend=0.0)))  # 0 before the first weight: the joint comes from anywhere
    stops += [(P, P, W, s) for P in (2.0 * BAR, 3.0 * BAR) for W, s in zip((0.0, *WEIGHTS), turns, strict=True)]
    trial = stranger.begin(DT, stranger.nominal.at_rest(0.0, 5.0), stranger.seed)
    rows = []
    for P1, P2, load, direction in stops:
        read = []
        for _ in range(round(DWELL / DT)):
            y = trial.measure()
            read.append([y[0], y[2], y[3]])
            trial.advance(np.array([P1, P2]), load)
        rows.append([*np.mean(read[-round(SHOWN / DT) :], axis=0), -load, direction])
    names = "theta", "P1", "P2", "torque", "direction"
    return dict(zip(names, np.array([row for row in rows if row[4]]).T, strict=True))


def moved(stranger: Stranger) -> tuple[Array, Array]:
    """Return times (n,) [s], and angles, commands and measured pressures (n, 5) of random steps of both pressures."""
    rng = np.random.default_rng([stranger.seed, 5])
    trial = stranger.begin(DT, stranger.nominal.at_rest(0.0, 5.0), stranger.seed + 1)
    u, until, rows = np.full(2, 2.5 * BAR), 100, []
    for k in range(round(SECONDS / DT)):
        if k == until:
            u, until = rng.uniform(1.5, 4.2, 2) * BAR, k + int(rng.uniform(0.4, 1.5) / DT)
        y = trial.measure()
        rows.append([y[0], *u, *y[2:]])
        trial.advance(u)
    return DT * np.arange(len(rows)), np.array(rows)
