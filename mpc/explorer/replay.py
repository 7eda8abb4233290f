"""A tracked run is played on the page sample by sample, at most some hundreds of them."""

from pathlib import Path

from allocator.units import DEG
from mpc.explorer.question import muscles
from mpc.trials.recordings import load_recording

_FRAMES = 400


def frames(path: Path) -> dict[str, object]:
    """Return times [s] and what the joint did in the run in `path`. Raises `InvalidFile`."""
    run = load_recording(path)
    every = range(0, run.t.size, max(1, run.t.size // _FRAMES))
    return {
        "name": path.name,
        "t": [float(run.t[k]) for k in every],
        "theta": [float(run.x[k, 0]) / DEG for k in every],
        "theta_ref": [float(run.theta_ref[k]) / DEG for k in every],
        "stiffness": [float(run.K[k]) for k in every],
        "stiffness_ref": [float(run.K_ref[k]) for k in every],
        "muscles": [muscles(run.plant.joint, float(run.x[k, 0]), *map(float, run.x[k, 2:])) for k in every],
    }
