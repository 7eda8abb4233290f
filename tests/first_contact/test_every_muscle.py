"""Every muscle that can be made goes through every command, on every kind of joint, in a process of a user.

Each model is fitted by `antagonist fit` to a noisy sample of itself; what it writes, and every muscle of the catalogue,
goes through allocate, map and export on the kinds of joints in turn, all on one kind in the same process. One model is
tracked as well, the one with a kink in the pressure: a compiler takes half a minute for each pair of a law and a
geometry, and laws that are affine are tracked by the README's commands.
"""

import csv
import json
import os
import subprocess
import sys
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest

from allocator.identification import fit, load_dataset
from allocator.muscles import MODELS, AffineMuscle, Muscle, TableMuscle
from allocator.muscles.catalogue import MUSCLES, SAROSI_DMSP_20_400N
from allocator.units import BAR, PERCENT
from mpc.trials.files import load_recording

from ..rigs.said import besides_compiling

ROOT = Path(__file__).parents[2]
COMMANDS, GEOMETRIES = ("allocate", "map", "export"), ("pulley", "lever", "table")
TRACKED = {"Wickramatunge2010": "pulley"}  # and the geometry
KNOTS = (3, 12)
NOISE = 0.02  # of the greatest force


def truth(model):
    """A muscle of this model: that which fits the measured map."""
    data = load_dataset("dmsp-20-300-map")
    return fit(model, data.contraction, data.pressure, data.force, folds=0).muscle


def write_sample(muscle, path):
    """300 noisy forces of `muscle` at pressures of 0.5 … 5 bar, as a test bench would write them."""
    rng = np.random.default_rng(13)
    P, eps = rng.uniform(0.5, 5, 300) * BAR, rng.uniform(0.0, 0.25, 300)
    F = np.where(muscle.covers(P, eps), muscle.force(P, eps), 0.0)
    F = np.maximum(F + NOISE * F.max() * rng.standard_normal(F.size), 0.0)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("contraction_pct", "pressure_bar", "force_N"))
        writer.writerows(np.stack([eps / PERCENT, P / BAR, F], axis=1).round(5).tolist())


def spent(folder, days):
    """What the commands of each day came to, one after the other in the same process, by the name of the day."""
    (folder / "days.json").write_text(json.dumps(days), encoding="utf-8")
    for name in days:
        (folder / name).mkdir(exist_ok=True)
    variables = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "120"}
    slow = "ignore:a step takes:UserWarning"  # on a machine busy with tests a step may be longer than its sample
    user = [sys.executable, "-W", "error", "-W", slow, str(Path(__file__).with_name("user.py"))]
    ran = subprocess.run(user, cwd=folder, env=variables, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    return json.loads((folder / "done.json").read_text(encoding="utf-8"))


def inspect(folder, done, muscle, geometry, tracked):
    """Nothing fails but the export of what has no closed form, or not as far as the report's joint turns."""
    closed = isinstance(muscle, AffineMuscle) and not muscle.limitation  # of some the stiffness cannot be commanded
    for command in COMMANDS:
        result = done[command]
        where = f"{folder.name} on a {geometry}, {command}: {result}"
        if command == "export" and (not closed or geometry == "pulley") and result["code"] == 2:
            assert "cannot be exported" in besides_compiling(result["err"]), where
            assert len(besides_compiling(result["err"]).splitlines()) == 1, where
            continue
        assert (result["code"], besides_compiling(result["err"])) == (0, ""), where
    assert (folder / f"{geometry}-c" / "antagonist.h").is_file() is (done["export"]["code"] == 0)
    if not tracked:
        return
    assert (done["track"]["code"], besides_compiling(done["track"]["err"])) == (0, "")
    assert load_recording(folder / f"{geometry}.npz").implementation == "compiled"
    [line] = [x for x in done["track"]["out"].splitlines() if "implementation of the step" in x]
    assert "compiled" in line


def on(geometry, names, chosen=None):
    """The names that the turn gives this geometry, or which have chosen it."""
    turns = {name: (chosen or {}).get(name, turn) for name, turn in zip(names, cycle(GEOMETRIES), strict=False)}
    return [name for name, turn in turns.items() if turn == geometry]


def table(knots):
    """A law in a table of as many rows."""
    eps = np.linspace(0.0, 0.26, knots)
    return TableMuscle(tuple(eps), tuple(SAROSI_DMSP_20_400N.A(eps)), tuple(SAROSI_DMSP_20_400N.B(eps)))


@pytest.mark.slow
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_every_muscle_goes_through_every_command(geometry, tmp_path):
    fitted, published = on(geometry, MODELS, TRACKED), on(geometry, MUSCLES)
    tables = [f"table-{knots}" for knots in KNOTS if knots == KNOTS[0] or geometry == "pulley"]  # as long as both
    days = {name: {"muscle": name} for name in published} | {name: {"muscle": "my.toml"} for name in fitted + tables}
    for name in fitted:
        (tmp_path / name).mkdir()
        write_sample(truth(MODELS[name]), tmp_path / name / "forces.csv")
        days[name]["fit"] = ["forces.csv", "--model", name, "--out", "my.toml"]
    for name in tables:
        (tmp_path / name).mkdir()
        table(int(name.partition("-")[2])).save(tmp_path / name / "my.toml")
    done = spent(
        tmp_path, {name: day | {"geometry": geometry, "tracked": name in TRACKED} for name, day in days.items()}
    )
    for name in fitted:
        assert (done[name]["fit"]["code"], done[name]["fit"]["err"]) == (0, "")
        assert type(Muscle.load(tmp_path / name / "my.toml")) is MODELS[name]
    for name in days:
        muscle = MUSCLES[name] if name in published else Muscle.load(tmp_path / name / "my.toml")
        inspect(tmp_path / name, done[name], muscle, geometry, name in TRACKED)


def test_every_muscle_has_a_turn():
    for names, chosen in ((MODELS, TRACKED), (MUSCLES, {})):
        assert sorted(name for geometry in GEOMETRIES for name in on(geometry, names, chosen)) == sorted(names)
