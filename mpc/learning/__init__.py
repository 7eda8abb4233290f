"""Learning: one motion by repeating it, and environments for reinforcement learning of arms."""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from mpc.arm.learning.actions import Governor as Governor
    from mpc.arm.learning.environment import ArmEnvironment as ArmEnvironment
    from mpc.arm.learning.environment import ArmVectorEnvironment as ArmVectorEnvironment
    from mpc.arm.learning.plant import ArmBatch as ArmBatch
    from mpc.arm.learning.plant import VariedArm as VariedArm
    from mpc.arm.learning.plant import Wall as Wall
    from mpc.arm.learning.task import Reaching as Reaching
    from mpc.arm.learning.task import Task as Task
    from mpc.arm.learning.variation import Variation as Variation
    from mpc.arm.learning.wiping import Wiping as Wiping
    from mpc.repetition.learner import Learner as Learner
    from mpc.repetition.learner import Reason as Reason
    from mpc.repetition.practice import Practice as Practice
    from mpc.repetition.practice import plot_learning as plot_learning
    from mpc.repetition.practice import practise as practise
    from mpc.repetition.response import Response as Response
    from mpc.repetition.response import response as response
    from mpc.repetition.response import responses as responses
    from mpc.repetition.update import Update as Update
    from mpc.trials.motions.corrections import Correction as Correction
    from mpc.trials.motions.corrections import Owner as Owner
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
