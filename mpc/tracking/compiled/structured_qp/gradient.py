"""Gradient of the cost by the changes of commands: stage by stage, and by an adjoint pass."""

from allocator.calculus import Array
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.records import Cost, Errors, Path, Point
from mpc.tracking.compiled.structured_qp.sizes import NU, NX, NXI, NY
from mpc.tracking.compiled.structured_qp.stage import changed, linear_before


@inlined_flat
def gradients(path: Path, errors: Errors, cost: Cost, at: Point, gx: Array, gv: Array) -> None:
    """Set the gradient of the cost without rows at a point: `gx` (N+1, 6) by ξ_k, k > 0, `gv` (N, 2) by v_k."""
    N, xi = gv.shape[0], at.xi
    for k in range(1, N):
        for i in range(NX):
            gx[k, i] = cost.x[i] * (errors.x[k, i] + xi[k, i])
        for m in range(NY):
            if cost.y[m] != 0.0:
                y = cost.y[m] * (errors.y[k, m] + changed(path.slope, k, m, xi))
                for i in range(NX):
                    gx[k, i] += y * path.slope[k, m, i]
        for i in range(NU):
            gx[k, NX + i] = cost.e[i] * (errors.e[k - 1, i] + xi[k, NX + i])
    for i in range(NXI):
        gx[N, i] = cost.e[i - NX] * (errors.e[N - 1, i - NX] + xi[N, i]) if i >= NX else 0.0
        for j in range(NXI):
            gx[N, i] += cost.end[i, j] * (errors.end[j] + xi[N, j])
    for k in range(N):
        for i in range(NU):
            gv[k, i] = cost.change[i] * (errors.change[k, i] + at.v[k, i])


@inlined
def adjoint(path: Path, gx: Array, gv: Array, r: Array) -> None:
    """Set `r` (N, 2) to the gradient by v alone, ξ following from it."""
    N = gv.shape[0]
    p = gx[N].copy()
    for k in range(N - 1, -1, -1):
        linear_before(p, path.A, path.B, k)
        for i in range(NU):
            r[k, i] = p[NX + i] + gv[k, i]
        if k > 0:
            for i in range(NXI):
                p[i] += gx[k, i]
