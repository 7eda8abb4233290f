"""Models of joints and their effects: plants, friction, faults, compensation."""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from mpc.model.faults import BrokenCable as BrokenCable
    from mpc.model.faults import DriftingSensor as DriftingSensor
    from mpc.model.faults import FrozenSensors as FrozenSensors
    from mpc.model.faults import Leak as Leak
    from mpc.model.faults import SilentSensors as SilentSensors
    from mpc.model.faults import StuckValve as StuckValve
    from mpc.model.faults import SupplyDrop as SupplyDrop
    from mpc.model.faults import WrongReadings as WrongReadings
    from mpc.model.friction.contact import first_push as first_push
    from mpc.model.friction.dahl import Friction as Friction
    from mpc.model.friction.maxwell_slip import MaxwellSlip as MaxwellSlip
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
