"""What NumPy alone runs, and what the rest says instead: `python -P tests/light/with_numpy_alone.py`.

Run where the package was installed with `pip install --no-deps` beside NumPy; a plain script, since pytest is missing.
"""

from importlib.util import find_spec

import numpy as np

import mpc
from allocator import DEG, MissingPackage, allocate, feasibility_map, report_joint
from allocator.identification import load_dataset, rank_models
from allocator.mechanism import machines

assert find_spec("scipy") is None, "this is to be run without SciPy"

a = allocate(30 * DEG, 7.5, 1.0)
assert a.success
assert a.jacobian().shape == (2, 3)
assert allocate(np.linspace(-1, 1, 100), 7.5, 1.0).P1.shape == (100,)
assert feasibility_map(np.linspace(-1, 1, 20), np.linspace(6, 9, 20), 0.0).status.shape == (20, 20)
assert abs(float(report_joint().equilibrium(2e5, 2e5))) < 1e-9
assert allocate([0.4, -0.3], [[10.0, 4.0], [4.0, 9.0]], [9.0, 4.0], joint=machines.arm26()).success
plant = mpc.Plant()


def told(library, call):
    """What is missing is named, with the line that installs it."""
    try:
        call()
    except MissingPackage as missing:
        said = str(missing)
    else:
        said = "nothing"
    assert f"this needs {library}, which is not installed: pip install {library}" in said, said


told("scipy", lambda: rank_models(load_dataset("dmsp-20-sheet")))
told("casadi", lambda: allocate(30 * DEG, 7.5, 1.0, method="nlp"))
told("matplotlib", lambda: feasibility_map(np.linspace(-1, 1, 5), np.linspace(6, 9, 5), 0.0).plot())
told("casadi", lambda: mpc.TrackingMPC(plant))
print("NumPy alone: allocate, its Jacobian, maps, a mechanism, import mpc")
