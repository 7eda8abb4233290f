"""Every muscle that can be made goes through every command, on every kind of joint, in a process of a user.

Each model is fitted by `antagonist fit` to a noisy sample of itself; what it writes, and every muscle of the catalogue,
goes through allocate, map and export on the kinds of joints in turn. Two models are tracked as well (affine in the
pressure, and with a kink): a compiler takes 15 s for each pair of a law and a geometry.
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

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
COMMANDS, GEOMETRIES = ("allocate", "map", "export"), ("pulley", "lever", "table")
TRACKED = "AffinePolynomial", "Wickramatunge2010"
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


def spent(folder, muscle, fitting=None, geometries=GEOMETRIES, tracked=""):
    """What the commands of such a day came to; the name of the joint that is tracked by "tracked"."""
    plan = {"fit": fitting, "muscle": muscle, "geometries": geometries, "tracked": tracked}
    (folder / "day.json").write_text(json.dumps(plan), encoding="utf-8")
    variables = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "120"}
    slow = "ignore:a step takes:UserWarning"  # on a machine busy with tests a step may be longer than its sample
    user = [sys.executable, "-W", "error", "-W", slow, str(Path(__file__).with_name("user.py"))]
    ran = subprocess.run(user, cwd=folder, env=variables, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    return json.loads((folder / "done.json").read_text(encoding="utf-8")) | {"tracked": tracked}


def inspect(folder, done, muscle, geometries=GEOMETRIES):
    """Nothing fails but the export of what has no closed form, or not as far as the report's joint turns."""
    closed = isinstance(muscle, AffineMuscle) and not muscle.limitation  # of some the stiffness cannot be commanded
    for geometry in geometries:
        for command in COMMANDS:
            result = done[f"{geometry} {command}"]
            where = f"{type(muscle).__name__} on a {geometry}, {command}: {result}"
            if command == "export" and (not closed or geometry == "pulley") and result["code"] == 2:
                assert "cannot be exported" in result["err"], where
                assert len(result["err"].splitlines()) == 1, where
                continue
            assert (result["code"], result["err"]) == (0, ""), where
        assert (folder / f"{geometry}-c" / "antagonist.h").is_file() is (done[f"{geometry} export"]["code"] == 0)
    if not done["tracked"]:
        return
    tracked = done[f"{done['tracked']} track"]
    assert (tracked["code"], tracked["err"]) == (0, "")
    assert load_recording(folder / f"{done['tracked']}.npz").implementation == "compiled"
    [line] = [x for x in tracked["out"].splitlines() if "implementation of the step" in x]
    assert "compiled" in line


@pytest.mark.parametrize(("name", "geometry"), list(zip(MODELS, cycle(GEOMETRIES), strict=False)))
def test_a_fitted_muscle_goes_through_every_command(name, geometry, tmp_path):
    write_sample(truth(MODELS[name]), tmp_path / "forces.csv")
    fitting = ["forces.csv", "--model", name, "--out", "my.toml"]
    done = spent(tmp_path, "my.toml", fitting, [geometry], tracked=geometry if name in TRACKED else "")
    assert (done["fit"]["code"], done["fit"]["err"]) == (0, "")
    muscle = Muscle.load(tmp_path / "my.toml")
    assert type(muscle) is MODELS[name]
    inspect(tmp_path, done, muscle, [geometry])


@pytest.mark.parametrize(("name", "geometry"), list(zip(MUSCLES, cycle(GEOMETRIES), strict=False)))
def test_a_muscle_of_the_catalogue_goes_through_every_command(name, geometry, tmp_path):
    inspect(tmp_path, spent(tmp_path, name, geometries=[geometry]), MUSCLES[name], [geometry])


@pytest.mark.parametrize("knots", KNOTS)
def test_a_table_of_any_length_goes_through_every_command(knots, tmp_path):
    eps = np.linspace(0.0, 0.26, knots)
    muscle = TableMuscle(tuple(eps), tuple(SAROSI_DMSP_20_400N.A(eps)), tuple(SAROSI_DMSP_20_400N.B(eps)))
    muscle.save(tmp_path / "my.toml")
    geometries = GEOMETRIES if knots == KNOTS[0] else ("pulley",)  # the law is as long as both together
    inspect(tmp_path, spent(tmp_path, "my.toml", geometries=geometries), muscle, geometries)
