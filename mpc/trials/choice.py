"""The trajectory of a command is chosen by its name or its file."""

from pathlib import Path

from allocator import checks
from allocator.errors import InvalidInput
from mpc.model.plant import Plant
from mpc.trials.files import default_trajectory, load
from mpc.trials.reference import Reference, sine
from mpc.trials.trajectories import TRAJECTORIES, shrunk, usual_stiffness


def reference_called(name: str | None, K: float | None, plant: Plant) -> Reference:
    """Return the trajectory of this name or in this file, about the stiffness K [N·m/rad] if it is a standard one.

    Without a name it is the default trajectory where the plant has the report's joint, a sine elsewhere. Raises
    `InvalidInput`.
    """
    if name is None and K is None and plant.joint == Plant().joint:
        return default_trajectory()
    if name is None or name in TRAJECTORIES:
        middle = usual_stiffness(plant.joint) if K is None else float(checks.stiffness("stiffness", K))
        about = TRAJECTORIES[name].about if name else lambda K: sine(K=K)
        return shrunk(about, middle, plant.joint)
    if K is not None:
        raise InvalidInput("--stiffness goes with a standard trajectory; a file has its own")
    if Path(name).suffix or Path(name).exists():
        return load(name)
    raise InvalidInput(f"there is neither a standard trajectory nor a file {name}; there are {', '.join(TRAJECTORIES)}")
