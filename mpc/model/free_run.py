"""Free run of a plant over the pressures of a log: no measured angle is fed back.

`free_run` simulates exactly the objects that `Plant.load` and `Compensation.load` return, so that an error stated for a
plant's file is the error of that file.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.codegen.buffered import Buffered
from mpc.model.plant import NU, NX
from mpc.model.real_plant import RealPlant

_RESOLUTION = 0.25  # of the integration, see `Plant.substeps`: 3e-5 of the change
_HELD = 1e6  # [s] lag of regulators whose pressures are imposed


def free_run(
    process: RealPlant, t: ArrayLike, P1: ArrayLike, P2: ArrayLike, *, begin: float | None = None,
    commanded: bool = True,
) -> Array:  # fmt: skip
    """Return the angle (n,) [rad] of `process` at the times `t` while the pressures of a log act on it.

    Parameters
    ----------
    process
        The plant with its friction and regulators: `RealPlant.of(Plant.load(path), Compensation.load(path))`.
    t
        Times [s], increasing; arrays (n,), as are the pressures.
    P1, P2
        Pressures of agonist and antagonist [Pa, gauge]. Each holds until the next.
    begin
        Initial angle [rad] of the joint at rest; by default the equilibrium at the first pressures, or 0 if there is
        none.
    commanded
        Whether the pressures are commands for the regulators. If false, they are the pressures in the muscles,
        interpolated linearly between rows.

    Raises
    ------
    InvalidInput
        If the arrays are not rows of numbers of one length, or `t` does not increase.
    """
    times, one, two = checks.real("t", t, "s"), checks.pressure("P1", P1), checks.pressure("P2", P2)
    if times.ndim != 1 or not times.shape == one.shape == two.shape or times.size < 2:
        raise InvalidInput("t, P1 and P2 have to be rows of numbers, one of each for every sample")
    if not (np.diff(times) > 0).all():
        raise InvalidInput("t has to increase from row to row [s]")
    u = np.stack([one, two], axis=1)
    full = _start(process, u[0], begin)
    if not commanded:
        return _integrated(_without_regulators(process), times, (u[1:] + u[:-1]) / 2, full, imposed=True)
    ends, acting = _acting(times, process.dead_time)
    return _integrated(process, ends, u[acting], full)[np.searchsorted(ends, times)]


def _without_regulators(process: RealPlant) -> RealPlant:
    """Return `process` with imposed pressures, without regulators."""
    nominal = replace(process.nominal, lag=_HELD, gas=None, frequency=0.0)
    return replace(process.without("lag_up", "lag_down", "dead_time", "dead_band", "flow"), nominal=nominal)


def _acting(t: Array, dead_time: float) -> tuple[Array, Array]:
    """Return the times (m,) [s] between which one command acts, including `t`, and the command's index (m - 1,)."""
    ends = np.unique(np.concatenate([t, (t + dead_time)[t + dead_time < t[-1]]]))
    middle = (ends[1:] + ends[:-1]) / 2
    return ends, np.maximum(np.searchsorted(t, middle - dead_time, side="right") - 1, 0)


def _start(process: RealPlant, P: Array, begin: float | None) -> Array:
    """Return the state with friction's memory (n,) at rest at the pressures P (2,) [Pa]."""
    theta = float(process.nominal.joint.equilibrium(*P)) if begin is None else float(begin)
    theta = theta if np.isfinite(theta) else 0.0
    return np.append([theta, 0.0, *P], process.friction.begun(theta))


def _integrated(process: RealPlant, ends: Array, u: Array, full: Array, *, imposed: bool = False) -> Array:
    """Return the angle (m,) [rad] at the times `ends` (m,) [s], from the state `full` (n,) on.

    The commands `u[k]` (2,) [Pa] act between `ends[k]` and the next; `imposed`: the muscles have these pressures.
    """
    step = _step(process, process.substeps(float(np.diff(ends).max()), _RESOLUTION))
    theta = [float(full[0])]
    for command, length in zip(u, np.diff(ends).tolist(), strict=True):
        if imposed:
            full[2:NX] = command
        full = step(full, command, length)[0][0]
        theta.append(float(full[0]))
    return np.array(theta)


def _step(process: RealPlant, substeps: int) -> Buffered:
    """Return (state, commands, duration) ↦ state, in equal steps."""
    import casadi as ca

    n = NX + process.friction.size
    full, u, h = ca.SX.sym("full", n), ca.SX.sym("u", NU), ca.SX.sym("h")
    later = ca.vertcat(*process.stepped(full[:NX], full[NX:], u, 0.0, h))
    fine = ca.Function("fine", [full, u, h], [ca.cse(ca.densify(later))])
    begin, held, duration = ca.MX.sym("full", n), ca.MX.sym("u", NU), ca.MX.sym("duration")
    end = begin
    for _ in range(substeps):
        end = fine(end, held, duration / substeps)
    return Buffered(ca.Function("step", [begin, held, duration], [end]))
