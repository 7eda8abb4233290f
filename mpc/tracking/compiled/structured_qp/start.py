"""Start of the exchange: a sweep with the limits of the last QP, or with better ones if these are far from right."""

from allocator.calculus import Array
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.records import Bounded, Errors, Path, Point, Setting
from mpc.tracking.compiled.structured_qp.active import Active, take_base
from mpc.tracking.compiled.structured_qp.certificate import lagrangian
from mpc.tracking.compiled.structured_qp.riccati import Sweep, backward, forward, within
from mpc.tracking.compiled.structured_qp.sizes import BOUND, FREE, NU, NX
from mpc.tracking.compiled.structured_qp.stage import advance, curvature

CLAMPED = 2  # sweeps that choose the held changes
FAR = 10.0  # [bar] beyond a limit; noise takes a set less far, and the exchange mends it


@inlined
def begin(path: Path, errors: Errors, setting: Setting, bounded: Bounded, at: Point, sweep: Sweep, a: Active) -> None:
    """Begin at the result of a sweep with the held changes of the last QP.

    If it is far from their limits, sweeps choose others, which saves three of four exchanges of hunted QPs.
    """
    items, last = a.items, a.items.kind.size - 1
    at.xi[:], at.v[:], at.sigma[:], a.z[:], items.multiplier[last], items.known[0] = 0.0, 0.0, 0.0, 0.0, 0.0, 0
    items.kind[last], items.sample[last], items.muscle[last], items.side[last] = BOUND, 0, 0, 0
    for turn in range(CLAMPED + 2):
        clamps = 0 < turn <= CLAMPED
        lagrangian(path, errors, setting, 0, at, items, sweep)
        backward(path, setting.cost, bounded, at, sweep, clamps)
        forward(path, bounded, sweep, at, a.r, clamps)
        if turn == 0:
            if not far(bounded, sweep, at, a.r):
                break
            confine(path, bounded, at)
    take_base(setting, 0, at, sweep, a)


@inlined_flat
def far(bounded: Bounded, sweep: Sweep, at: Point, r: Array) -> bool:
    """Return whether a free change is far beyond its limits, or a held one pushed far away from them."""
    for k in range(at.v.shape[0]):
        for i in range(NU):
            v, w, held = at.v[k, i], at.xi[k + 1, NX + i], sweep.held[k, i]
            push = (1.0 if held > 0 else -1.0) * r[k, i] / curvature(sweep.D, k, i) if held != FREE else 0.0
            beyond = max(max(bounded.lower[k, i] - v, v - bounded.upper[k, i]), push)
            beyond = max(max(bounded.low[k, i] - w, w - bounded.high[k, i]), beyond)
            if beyond > FAR and bounded.lower[k, i] < bounded.upper[k, i]:
                return True
    return False


@inlined_flat
def confine(path: Path, bounded: Bounded, at: Point) -> None:
    """Move the changes of the point within slew and supply."""
    for k in range(at.v.shape[0]):
        for i in range(NU):
            at.v[k, i] = within(bounded, at.v[k, i], at.xi[k, NX + i], k, i)
            at.xi[k + 1, NX + i] = at.xi[k, NX + i] + at.v[k, i]
        advance(path.A, path.B, k, at.xi)
