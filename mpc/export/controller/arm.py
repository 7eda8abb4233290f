"""Controller of an arm as C: the files of its allocation, model and control, and the reasons for a refusal."""

from allocator.errors import InvalidInput
from mpc.export import text
from mpc.export.controller.demonstration import control_lines
from mpc.export.controller.model import arm_functions
from mpc.export.controller.readme import arm_readme
from mpc.export.controller.sizes import control_files, sizes_of
from mpc.export.mechanism import mechanism_files, mechanism_functions, mechanism_lines, mechanism_sizes
from mpc.export.parts import Files, model_files
from mpc.model.arm.model import Arm
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC


def check_arm(arm: Arm) -> None:
    """Raise `InvalidInput` for an arm whose controller cannot be exported."""
    if arm.unformulated:
        why = f"{arm.unformulated}, which C needs"
    elif arm.gas is not None:
        why = "its C has no gas; leave the gas out, Arm(…, gas=None)"
    elif arm.endpoint is not None:
        why = "its C tracks the stiffness of the joints, not that of a hand; leave the endpoint out"
    elif not arm.mechanism.affine:
        why = "its allocation in C takes muscles that are affine in the pressure"
    else:
        return
    raise InvalidInput(f"the controller of this arm cannot be exported: {why}")


def arm_controller_files(controller: TrackingMPC, observer: KalmanObserver, single: bool, alone: bool) -> Files:
    """Return the files of allocation and controller; `alone` leaves the demonstration of the allocation out."""
    mechanism = controller.plant.mechanism
    printed = ([] if alone else mechanism_lines(mechanism)) + list(control_lines(controller, observer))
    functions = mechanism_functions(mechanism) + arm_functions(controller)
    return {
        **mechanism_files(mechanism, single, alone),
        **control_files(controller, observer, single),
        **model_files(functions, single, ["motion.h"]),
        "antagonist_config.h": text.config(mechanism_sizes(mechanism) | sizes_of(controller, single), single),
        "README.md": arm_readme(controller, single, printed),
    }
