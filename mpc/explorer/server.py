"""Server of the page and of its questions as JSON, on this machine only.

Explorer as one file: the page with its answers on a grid, for a browser without the command.

Every number is an answer of `allocate`: the page's sliders step along the grid and nothing is interpolated. Supply,
geometry and valves are those of the joint.
"""

import gzip
import json
from base64 import b64encode
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from allocator import AntagonistJoint, stiffness_interval
from allocator.calculus import Array
from allocator.errors import AntagonistError, InvalidFile
from allocator.units import DEG
from mpc.explorer.question import Answer, Question, describe, muscles
from mpc.model.plant import Plant
from mpc.trials.files import load_recording
from mpc.trials.simulation import Run

Grid: TypeAlias = dict[str, list[float]]
"""Least and greatest value and step by name, in the page's units."""

_ANGLES, _STIFFNESSES, _TORQUES = 25, 25, 16  # steps at most
_DIGITS = 6
_PLACE = '<script id="saved" type="text/plain"></script>'


def grid(joint: AntagonistJoint) -> Grid:
    """Return the grid: angles [°] of the joint's range, stiffnesses [N·m/rad] and torques [N·m] within its reach."""
    left, right = (angle / DEG for angle in joint.angle_range)
    middle, high = sum(joint.angle_range) / 2, joint.pressure_limits[1]
    reach = 0.8 * float(joint.torque(middle, high, joint.pressure_limits[0]))
    most = 1.1 * float(joint.stiffness(middle, high, high))
    _, last, step = _steps(0.0, most, _STIFFNESSES)
    return {
        "theta": _steps(left, right, _ANGLES),
        "stiffness": [step, last, step],
        "torque": _steps(-reach, reach, _TORQUES),
    }


def saved_page(
    joint: AntagonistJoint,
    run: dict[str, object] | None = None,
    progress: Callable[[Sequence[Question]], Iterable[Question]] = iter,
) -> str:
    """Return the page as HTML.

    Parameters
    ----------
    joint
        Joint of two muscles.
    run
        Frames of a run that the page plays, see `mpc.explorer.server.frames`.
    progress
        Wrapper of the iteration over the grid, e.g. `rich.progress.track`.
    """
    axes = grid(joint)
    theta, K, T = (np.round(np.arange(low, high + step / 2, step), 9) for low, high, step in axes.values())
    reach = dict(zip(product(theta, T), zip(*_reach(joint, theta, T), strict=True), strict=True))
    targets = [Question(*target) for target in product(*(axis.tolist() for axis in (theta, K, T)))]
    states = [Answer(target, joint).state(reach[target.theta, target.torque]) for target in progress(targets)]
    outlines = [Answer(Question(torque=float(torque)), joint).outline() for torque in T]
    known = describe(joint) | {"run": run, "controls": [], "gas": False}
    answers = {"grid": axes, "joint": known, "states": states, "outlines": outlines}
    packed = gzip.compress(json.dumps(_rounded(answers), allow_nan=False).encode(), mtime=0)
    page = resources.files("mpc.explorer").joinpath("page.html").read_text(encoding="utf-8")
    return page.replace(_PLACE, _PLACE.replace("><", f">{b64encode(packed).decode()}<"))


def _reach(joint: AntagonistJoint, theta: Array, T: Array) -> Iterable[list[float]]:
    """Return the ends of the feasible stiffnesses [N·m/rad], each with T fastest."""
    ends = stiffness_interval(theta[:, None] * DEG, T, joint=joint)
    return (end.ravel().tolist() for end in ends)


def _steps(low: float, high: float, most: int) -> list[float]:
    """Return ends and step of a round grid with 0 on it and at most `most` steps."""
    rough = (high - low) / most
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(step for step in (power, 2 * power, 2.5 * power, 5 * power, 10 * power) if step >= rough * (1 - 1e-9))
    return [float(np.round(end, 9)) for end in (np.ceil(low / step) * step, np.floor(high / step) * step, step)]


def _rounded(found: object) -> object:
    """Return the answers with numbers of `_DIGITS` digits."""
    match found:
        case float():
            return float(f"{found:.{_DIGITS}g}")
        case dict():
            return {name: _rounded(value) for name, value in found.items()}
        case list():
            return [_rounded(value) for value in found]
    return found


HOST = "127.0.0.1"
_NAMES = (HOST, "localhost")  # other host names are refused, against DNS rebinding


def server(joint: AntagonistJoint, run: dict[str, object] | None, port: int) -> ThreadingHTTPServer:
    """Return a server for `joint`, and for the frames of a run if there is one; port 0 takes any that is free.

    Raises `OSError` if the port is taken.
    """
    return ThreadingHTTPServer((HOST, port), partial(_Handler, joint, run))


class _Handler(BaseHTTPRequestHandler):
    """Handler of one request, with a timeout for idle connections, since each needs a thread."""

    timeout = 30.0  # [s]

    def __init__(self, joint: AntagonistJoint, run: dict[str, object] | None, *given: Any) -> None:
        self.joint, self.run = joint, run
        super().__init__(*given)

    def do_GET(self) -> None:
        """Answer with the page or JSON; invalid questions get an error message."""
        if self.headers.get("Host", "").rpartition(":")[0] not in _NAMES:
            self._send(HTTPStatus.FORBIDDEN, "text/plain", b"this page is for this machine")
            return
        asked = urlsplit(self.path)
        if asked.path == "/":
            page = resources.files("mpc.explorer").joinpath("page.html").read_bytes()
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", page)
            return
        try:
            found = self._found(asked.path, dict(parse_qsl(asked.query)))
        except AntagonistError as error:
            self._json(HTTPStatus.BAD_REQUEST, {"error": str(error)})
            return
        if found is None:
            self._json(HTTPStatus.NOT_FOUND, {"error": f"there is no {asked.path}"})
        else:
            self._json(HTTPStatus.OK, found)

    def _found(self, path: str, given: dict[str, str]) -> dict[str, object] | None:
        match path:
            case "/joint":
                return describe(self.joint) | {"run": self.run}
            case "/state":
                return Answer(Question.of(given), self.joint).state()
            case "/outline":
                return Answer(Question.of(given), self.joint).outline()
        return None

    def _json(self, status: HTTPStatus, found: dict[str, object]) -> None:
        self._send(status, "application/json", json.dumps(found, allow_nan=False).encode())

    def _send(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *given: object) -> None:  # the name is that of the base class
        """Log nothing, because the page shows errors."""


_FRAMES = 400


def joint_run(path: Path) -> Run:
    """Return the run of a joint in `path`. Raises `InvalidFile` for that of an arm, and for any other file."""
    run = load_recording(path)
    if not isinstance(run.plant, Plant):
        raise InvalidFile(path, "is the recording of an arm; the explorer plays those of one joint")
    return run


def frames(path: Path) -> dict[str, object]:
    """Return times [s] and the joint's motion in the run in `path`. Raises `InvalidFile`."""
    run = joint_run(path)
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
