"""Files of corrections, which are learned by repetition of a motion and can be replayed.

[correction]                   # written by `track --repeat` and `run --repeat`
name = "sine"
joint = "two Tondu2000, …"     # description
digest = "9f…"                 # of the joint's model
controller = "mpc"
load = ""                      # name of the load
errors = [1.7, 0.4, …]         # RMS by repetition [rad]
tail = 0.0                     # [s] at the end, for preview only

[correction.motion]            # SI units, one number or row per sample
t, theta, K, shift             # theta: desired angle; theta + shift: reference

A correction belongs to a motion, a joint, a load and a controller, and is refused for others.
"""

from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.files.atomic import write_text
from allocator.files.text import FilePath
from allocator.files.toml import Table, section
from allocator.machine_file import dumps
from allocator.units import DEG
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import Run

SPEEDS = 0.8, 1.25  # range of speeds, relative to the learned one, to which a correction is scaled
_SAME = 0.005  # [-] of the range of angle and stiffness: less counts as the same path
_STILL = 1e-6  # [-] of the ranges


@dataclass(frozen=True)
class Owner:
    """Joint, controller and load that a correction belongs to."""

    joint: str  # in words
    digest: str  # of the joint's model
    controller: str = "mpc"
    load: str = ""  # in words

    @classmethod
    def of(cls, plant: Plant, known: Compensation, controller: str = "mpc", load: str = "") -> Self:
        """Return the owner of a correction from the joint, its compensation, its controller and its load."""
        return cls(plant.summary, digest_of(dumps(plant.joint), plant.numbers, known), controller, load)


def digest_of(*parts: object) -> str:
    """Return a digest of a model, from its text or the `repr` of its parts."""
    return sha256("\0".join(map(str, parts)).encode()).hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class Correction:
    """Motion with the correction of its reference."""

    wanted: Reference
    shift: Array  # (M, …) [rad], as the angles of `wanted`
    owner: Owner
    errors: tuple[float, ...] = ()  # RMS by repetition [rad]

    def __post_init__(self) -> None:
        if self.shift.shape != self.wanted.theta.shape:
            shapes = f"{self.shift.shape} and {self.wanted.theta.shape}"
            raise InvalidInput(f"shift and theta have to have one shape; theirs are {shapes}")

    @property
    def reference(self) -> Reference:
        """Corrected reference, a trajectory like any other."""
        return replace(self.wanted, theta=self.wanted.theta + self.shift)

    @property
    def summary(self) -> str:
        """One line with motion, controller, load and gain."""
        load = f", load: {self.owner.load}" if self.owner.load else ""
        gained = f": {self.errors[0] / DEG:.3g}° → {min(self.errors) / DEG:.3g}° RMS" if self.errors else ""
        return f"correction of {self.wanted.name or 'a motion'} with {self.owner.controller}{load}{gained}"

    def check(self, owner: Owner, path: FilePath = "the correction") -> None:
        """Raise `InvalidInput` unless the correction belongs to `owner`."""
        mine = self.owner
        if mine.digest != owner.digest:
            raise InvalidInput(
                f"{path} was learned on another joint ({mine.joint}; digest {mine.digest}), not on this one "
                f"({owner.joint}; digest {owner.digest}); learn it again with --repeat"
            )
        for what, learned, given in (
            ("controller", mine.controller, owner.controller),
            ("load", mine.load or "no load", owner.load or "no load"),
        ):
            if learned != given:
                raise InvalidInput(
                    f"{path} was learned with another {what}: {learned}, not {given}; learn it again with --repeat"
                )

    def along(
        self, other: Reference, path: FilePath = "the correction", speeds: tuple[float, float] = SPEEDS
    ) -> "Correction":
        """Return the correction for the same motion at another speed, scaled in time. Raises `InvalidInput`.

        The motion between first and last rest has to have the same path of angle and stiffness, at `speeds` times the
        learned speed. Hysteresis depends on the path alone, but lags and inertia do not. A correction is therefore
        refused beyond these speeds.
        """
        mine, theirs = _moving(self.wanted), _moving(other)
        speed = (mine[1] - mine[0]) / max(theirs[1] - theirs[0], 1e-12)
        at = _onto(other.t, theirs, self.wanted.t, mine)
        for name, unit in (("theta", "rad"), ("K", "N·m/rad")):
            learned, asked = getattr(self.wanted, name), getattr(other, name)
            if learned.shape[1:] != asked.shape[1:] or not _close(_at(self.wanted.t, learned, at), asked, unit):
                raise InvalidInput(f"{path} was learned for another motion ({self.wanted.summary()})")
        low, high = speeds
        if not low <= speed <= high:
            raise InvalidInput(
                f"{path} was learned at another speed: this motion is {speed:.2f} times as fast, and a correction is "
                f"scaled in time from {low:g} to {high:g} times; learn it again with --repeat"
            )
        return replace(self, wanted=other, shift=_at(self.wanted.t, self.shift, at))

    def save(self, path: FilePath) -> None:
        """Write the file. Raises `CannotWrite`."""
        w, o = self.wanted, self.owner
        about: dict[str, Any] = {"name": w.name, "joint": o.joint, "digest": o.digest, "controller": o.controller}
        about |= {"load": o.load, "errors": tuple(map(float, self.errors)), "tail": float(w.tail)}
        motion = {"t": w.t, "theta": w.theta, "K": w.K.reshape(w.t.size, -1) if w.K.ndim > 1 else w.K}
        lines = section("correction", about, "errors by repetition [rad]")
        lines += section("correction.motion", motion | {"shift": self.shift}, "s, rad, N·m/rad, rad")
        write_text(path, "\n".join(lines).lstrip() + "\n")

    @classmethod
    def load(cls, path: FilePath) -> Self:
        """Read a file written by `save`. Raises `InvalidFile`."""
        table = Table.read(path).needed("correction", "a correction of `--repeat`")
        motion = table.needed("motion", "a correction of `--repeat`")
        try:
            e, m = table.entries, {n: checks.real(n, motion.entries[n], "") for n in ("t", "theta", "K", "shift")}
            if m["K"].ndim > 1:
                rows = round(np.sqrt(m["K"].shape[1]))
                m["K"] = m["K"].reshape(-1, rows, rows)
            wanted = Reference(m["t"], m["theta"], m["K"], str(e["name"]), float(e["tail"]))
            owner = Owner(*(str(e[name]) for name in ("joint", "digest", "controller", "load")))
            return cls(wanted, m["shift"], owner, tuple(float(one) for one in e["errors"]))
        except KeyError as error:
            raise table.fault(f"{error.args[0]} is missing") from None
        except (InvalidInput, TypeError, ValueError) as error:
            raise table.fault(error) from None


def compared(run: Run, wanted: Reference) -> Run:
    """Return a run along a corrected reference with the desired angles as its reference."""
    return replace(run, theta_ref=wanted.resampled(run.dt).theta[: run.t.size])


def _moving(reference: Reference) -> tuple[float, float]:
    """Return the times at which the motion begins and ends [s]."""
    moved = np.zeros(reference.t.size - 1, bool)
    for values in (reference.theta, reference.K):
        rows = values.reshape(reference.t.size, -1)
        moved |= (np.abs(np.diff(rows, axis=0)) > _STILL * max(float(np.ptp(rows)), 1e-9)).any(axis=1)
    if not moved.any():
        return float(reference.t[0]), float(reference.t[-1])
    here = np.flatnonzero(moved)
    return float(reference.t[here[0]]), float(reference.t[here[-1] + 1])


def _onto(t: Array, theirs: tuple[float, float], of: Array, mine: tuple[float, float]) -> Array:
    """Return the learned times for the times `t` of the other motion: first rest, motion and last rest each scaled."""
    return np.asarray(np.interp(t, [t[0], *_apart(theirs, t)], [of[0], *_apart(mine, of)]))


def _apart(moving: tuple[float, float], t: Array) -> list[float]:
    """Return the ends of motion and of the reference, made distinct for interpolation."""
    begin, end = moving
    begin = max(begin, float(t[0]) + 1e-9)
    return [begin, end, max(float(t[-1]), end + 1e-9)]


def _at(t: Array, values: Array, at: Array) -> Array:
    rows = values.reshape(t.size, -1)
    columns = np.stack([np.interp(at, t, row) for row in rows.T], axis=1)
    return np.asarray(columns.reshape(at.size, *values.shape[1:]), float)


def _close(one: Array, other: Array, unit: str) -> bool:
    """Return whether two paths are the same, within a share of the range of angles or of the size of stiffness."""
    scale = max(float(np.ptp(other)), DEG) if unit == "rad" else float(np.abs(other).max())
    return bool(np.abs(one - other).max() <= _SAME * scale)
