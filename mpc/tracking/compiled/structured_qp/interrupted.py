"""Answer of an interrupted exchange: changes within slew and supply, and the bound of their suboptimality."""

from allocator.calculus import Array
from mpc.codegen.jit import inlined
from mpc.tracking.compiled.records import Bounded, Errors, Path, Point, Setting
from mpc.tracking.compiled.structured_qp.active import Active, end, lead_on
from mpc.tracking.compiled.structured_qp.certificate import gap, priced, soften
from mpc.tracking.compiled.structured_qp.gradient import adjoint, gradients
from mpc.tracking.compiled.structured_qp.riccati import Sweep
from mpc.tracking.compiled.structured_qp.sizes import NU


@inlined
def interrupted(
    path: Path, errors: Errors, setting: Setting, bounded: Bounded, size: int, at: Point, sweep: Sweep, a: Active
) -> float:  # fmt: skip
    """Set the point to the changes within slew and supply, with the slacks that they need, or to the origin if that
    costs less; return the bound of its suboptimality, the primal cost minus the dual one. Costs are relative to that of
    the origin without slacks.
    """
    lead_on(path, at, a)
    dual = priced(setting, at) - gap(path, errors, setting, bounded, size, a.held, at, a.items, sweep)
    at.xi[:], at.v[:] = 0.0, 0.0
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    adjoint(path, sweep.gx, sweep.gv, a.dr)
    origin = soften(path, setting, at)
    lead_on(path, at, a)
    dual += increase(path, errors, setting, a.dr, at, sweep)
    end(path, bounded, size, at, sweep, a)
    primal = soften(path, setting, at) + increase(path, errors, setting, a.dr, at, sweep)
    if not primal < origin:
        at.xi[:], at.v[:] = 0.0, 0.0
        primal = soften(path, setting, at)
    return float(max(primal - dual, 0.0))


@inlined
def increase(path: Path, errors: Errors, setting: Setting, first: Array, at: Point, sweep: Sweep) -> float:
    """Return the cost of the changes minus that of the origin, where the gradient is `first`."""
    total = 0.0
    gradients(path, errors, setting.cost, at, sweep.gx, sweep.gv)
    adjoint(path, sweep.gx, sweep.gv, sweep.g)
    for k in range(at.v.shape[0]):
        for i in range(NU):
            total += 0.5 * (first[k, i] + sweep.g[k, i]) * at.v[k, i]
    return total
