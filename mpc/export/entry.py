"""Function `export`: allocation and controller of a joint or an arm as a directory of C files."""

from os import PathLike
from pathlib import Path

from allocator import checks
from allocator.errors import InvalidInput, MissingBackend
from allocator.joint.antagonist import AntagonistJoint, report_joint
from mpc.export import text
from mpc.export.building import check, write
from mpc.export.controller.demonstration import allocation_lines, allocation_table, arm_readme, control_lines, readme
from mpc.export.controller.model import arm_functions, joint_functions
from mpc.export.controller.sizes import check_pair, control_files, sizes_of
from mpc.export.joint import kernel_of
from mpc.export.mechanism import (
    export_mechanism,
    mechanism_files,
    mechanism_functions,
    mechanism_lines,
    mechanism_sizes,
)
from mpc.export.parts import Files, allocation_files, copied, is_single, kernel_functions, model_files
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.cost import Weights

WHAT = ("allocate", "mpc", "all")


def export(
    out: str | PathLike[str],
    *,
    joint: AntagonistJoint | None = None,
    controller: TrackingMPC | None = None,
    observer: KalmanObserver | None = None,
    what: str = "all",
    precision: str = "double",
) -> Path:
    """Write C files to the directory `out`, and return it.

    Parameters
    ----------
    joint
        Joint of the allocation; by default that of the controller, or of the report. Not for an arm.
    controller, observer
        For "mpc": the controller of a `Plant` or an `Arm` with its compensation, and its observer; by default those for
        `Plant(joint)` with N = 10, the joint's own hysteresis or friction and `Weights.calm()`.
    what
        "allocate", "mpc" or "all". "mpc" includes the allocation, without its demonstration.
    precision
        "double", or "single" for a single-precision FPU.

    Raises
    ------
    InvalidInput
        For a joint without a closed-form allocation, an arm without formulas, with a hand or muscles that are not
        affine, a controller and an observer that do not match, and a directory that is not empty. Nothing is written
        then.
    MissingBackend
        For an unknown `what` or `precision`.
    """
    if what not in WHAT:
        raise MissingBackend("part to export", what, WHAT)
    single = is_single(precision)
    check(Path(out))
    if what == "allocate" and controller is not None and isinstance(controller.plant, Arm):
        return export_mechanism(out, controller.plant.mechanism, precision=precision)
    if what == "allocate":
        joint = _joint(joint, None if controller is None else controller.plant.joint)
        return write(_allocation(joint, single), out)
    controller, observer = pair(joint, controller, observer)
    return write(controller_files(controller, observer, single, alone=what == "mpc"), out)


def _default_controller(joint: AntagonistJoint) -> TrackingMPC:
    """Return the default controller for `joint`, with weights for joints that differ from their model.

    It compensates the joint's own hysteresis or friction, and it is not compiled in Python. Raises InvalidInput for a
    joint that cannot be exported.
    """
    kernel_of(joint)
    return TrackingMPC(Plant(joint), N=10, weights=Weights.calm(), compensation=Compensation.of(joint), compiled=False)


def _joint(given: AntagonistJoint | None, own: AntagonistJoint | None) -> AntagonistJoint:
    if given is not None and own is not None and given != own:
        raise InvalidInput("joint is not the one of the controller's plant; give only one of the two")
    return given or own or report_joint()


def pair(
    joint: AntagonistJoint | None, controller: TrackingMPC | None, observer: KalmanObserver | None
) -> tuple[TrackingMPC, KalmanObserver]:
    """Return controller and observer, by default those of `export`. Raises `InvalidInput`; see `export`."""
    for name, part, kind in (("controller", controller, TrackingMPC), ("observer", observer, KalmanObserver)):
        checks.instance(name, part, kind | None, f"a {kind.__name__}")
    if controller is not None and isinstance(controller.plant, Arm):
        if joint is not None:
            raise InvalidInput("joint is for a controller of one joint; leave it away for that of an arm")
        check_arm(controller.plant)
    else:
        joint = _joint(joint, None if controller is None else controller.plant.joint)
        controller = controller or _default_controller(joint)
    if observer is None:
        observer = KalmanObserver(
            controller.plant, controller.dt, compensation=controller.compensation, compiled=controller.compiled
        )
    check_pair(controller, observer)
    return controller, observer


def _allocation(joint: AntagonistJoint, single: bool) -> Files:
    kernel = kernel_of(joint)
    return {
        **dict(copied(".", "")),
        **allocation_files(joint, kernel, single),
        **model_files(kernel_functions(joint, kernel), single),
        "antagonist_config.h": text.config({}, single),
        "src/demonstration.h": allocation_table(joint, single),
        "README.md": readme(joint, kernel.name, single, list(allocation_lines(joint))),
    }


def controller_files(controller: TrackingMPC, observer: KalmanObserver, single: bool, alone: bool) -> Files:
    """Return the files of allocation and controller; `alone` leaves the demonstration of the allocation out."""
    told = list(control_lines(controller, observer))
    sizes, files = sizes_of(controller, single), control_files(controller, observer, single)
    if isinstance(controller.plant, Arm):
        mechanism = controller.plant.mechanism
        printed = ([] if alone else mechanism_lines(mechanism)) + told
        functions = mechanism_functions(mechanism) + arm_functions(controller)
        sizes = mechanism_sizes(mechanism) | sizes
        files |= mechanism_files(mechanism, single, alone) | {"README.md": arm_readme(controller, single, printed)}
    else:
        joint = controller.plant.joint
        kernel = kernel_of(joint)
        printed = ([] if alone else list(allocation_lines(joint))) + told
        functions = kernel_functions(joint, kernel) + joint_functions(controller)
        files = _allocation(joint, single) | files
        files["src/demonstration.h"] = allocation_table(joint, single, alone)
        files["README.md"] = readme(joint, kernel.name, single, printed, controller)
    formulas = model_files(functions, single, ["motion.h"])
    return files | formulas | {"antagonist_config.h": text.config(sizes, single)}


def check_arm(arm: Arm) -> None:
    """Raise `InvalidInput` for an arm whose controller cannot be exported."""
    if arm.unformulated:
        why = f"{arm.unformulated}, which C needs"
    elif arm.endpoint is not None:
        why = "its C tracks the stiffness of the joints, not that of a hand; leave the endpoint out"
    elif not arm.mechanism.affine:
        why = "its allocation in C takes muscles that are affine in the pressure"
    else:
        return
    raise InvalidInput(f"the controller of this arm cannot be exported: {why}")
