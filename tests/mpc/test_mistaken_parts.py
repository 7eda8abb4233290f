"""Parts that a newcomer gives to the wrong constructor: one sentence each."""

import pytest

from allocator.errors import InvalidInput
from allocator.mechanism.machines import arm26
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import KalmanObserver, Plant, RealPlant, sine


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        (lambda: Plant("joint.toml"), r"joint = 'joint.toml' has to be an AntagonistJoint; Plant.load reads a file"),
        (lambda: Plant(SAROSI_DMSP_20_400N), "has to be an AntagonistJoint"),
        (lambda: Plant(arm26()), "an Arm has several joints"),
        (lambda: RealPlant(Plant().joint), "nominal = .* has to be a Plant"),
        (lambda: KalmanObserver(RealPlant(), 0.01), "has to be a Plant or an Arm; the model of a RealPlant is its nom"),
        (lambda: KalmanObserver(Plant().joint, 0.01), "has to be a Plant or an Arm"),
        (lambda: sine(Plant()), r"amplitude = .* \[rad\]"),
        (lambda: sine(K=None), r"K = None .*\[N·m/rad\]"),
        (lambda: sine(duration="12"), r"duration = '12' .*\[s\]"),
        (lambda: sine(40.0), "if degrees were meant"),
    ],
)
def test_a_mistaken_part_is_named(made, sentence):
    with pytest.raises(InvalidInput, match=sentence) as refused:
        made()
    assert "\n" not in str(refused.value)
