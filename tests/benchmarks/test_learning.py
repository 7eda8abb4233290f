"""The baseline learner learns, and repeats by its seed."""

import numpy as np
import pytest

from benchmarks.arm import learning
from mpc.arm.learning.environment import ArmVectorEnvironment


@pytest.mark.slow
def test_a_few_generations_are_better_than_none():
    examiner = ArmVectorEnvironment(64, learning.task("pressures"))
    found = learning.learn("pressures", 0, 8)
    assert (learning.learn("pressures", 1, 1) == learning.learn("pressures", 1, 1)).all()
    none, learned = (learning.run(examiner, W[None], learning.UNSEEN).returned for W in (0 * found, found))
    gained = learned - none  # by the same arms, with the same postures and pushes
    assert gained.mean() > 2 * gained.std() / np.sqrt(64)
