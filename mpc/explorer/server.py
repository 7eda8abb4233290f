"""Server of the page and of its questions as JSON, on this machine only."""

import json
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from allocator import AntagonistJoint
from allocator.errors import AntagonistError
from allocator.units import DEG
from mpc.explorer.question import Answer, Question, describe, muscles
from mpc.trials.files import load_recording

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


def frames(path: Path) -> dict[str, object]:
    """Return times [s] and the joint's motion in the run in `path`. Raises `InvalidFile`."""
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
