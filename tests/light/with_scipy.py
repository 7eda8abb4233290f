"""What SciPy adds: fits, levers, the edges of maps: `python -P tests/light/with_scipy.py`, as `with_numpy_alone.py`."""

from importlib.util import find_spec

from allocator import AntagonistJoint, Lever, Stiffness, allocate, feasibility_map, named_muscle, stiffness_interval
from allocator.identification import load_dataset, rank_models

assert find_spec("casadi") is None, "this is to be run without CasADi"

assert rank_models(load_dataset("dmsp-20-sheet"))
muscle = named_muscle("sarosi-dmsp-20-400n")
joint = AntagonistJoint(Lever(rest_length=0.25, anchor=0.1655, lever=0.05094, offset=0.051), muscle, muscle)
assert allocate(0.1, sum(stiffness_interval(0.1, joint=joint)) / 2, 0.0, joint=joint).success
assert feasibility_map([-1.0, 1.0], [6.0, 9.0], 0.0).edges
assert allocate(0.5, 12.0, 1.0, stiffness=Stiffness("free")).P1 > 0
print("SciPy besides: fits, levers, edges of maps, trapped gas")
