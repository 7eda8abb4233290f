"""Simulated counterpart of any machine: a `RealPlant` of a joint, a `RealArm` of an arm."""

from typing import Any, TypeAlias

from allocator import checks
from allocator.errors import InvalidInput
from mpc.model.compensation import Compensation
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.model.real_arm import RealArm
from mpc.model.real_experiment import RealMachine
from mpc.model.real_plant import RealPlant

Real: TypeAlias = RealPlant | RealArm


def real_of(machine: Machine | RealMachine, known: Compensation | None = None, **effects: Any) -> Real:
    """Return `machine` with the `known` friction and regulators and further `effects` by name.

    A `Real` machine is returned as it is. Raises `InvalidInput` for other types and for implausible effects.
    """
    if isinstance(machine, Real):
        return machine
    if not isinstance(machine, Machine):
        raise InvalidInput(f"{checks.brief(machine)} is no machine: give a Plant, an Arm, a RealPlant or a RealArm")
    kind: Any = RealPlant if isinstance(machine, Plant) else RealArm
    made: Real = kind(machine, **effects) if known is None else kind.of(machine, known, **effects)
    return made
