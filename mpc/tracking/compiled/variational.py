"""The variational equations are those of a state's derivatives on its way: S' = ∂f/∂x S + (0, ∂f/∂u), from S = (1, 0).

S = (A, B) has zeros that stay: what only the regulators move, it says little of. The other entries alone are reckoned
with, as scalars of one tuple y = (x, entries of S, columns first), which never goes through the memory.
"""

from typing import Any

from mpc.model.plant import NU, NX


def variational(x: Any, u: Any, d: Any, rate: Any) -> Any:
    """Return the CasADi function (x, S, u, d) ↦ (x', S') of x' = `rate`, an expression of `x`, `u` and `d`; of S and S'
    the entries of the same places are there.
    """
    import casadi as ca

    jacobian, source = ca.jacobian(rate, x), ca.horzcat(ca.SX(NX, NX), ca.jacobian(rate, u))
    pattern, grown = None, ca.horzcat(ca.DM.eye(NX), ca.DM(NX, NU)).sparsity()
    while pattern is None or grown != pattern:
        pattern, S = grown, ca.SX.sym("S", grown)
        slope = jacobian @ S + source
        grown = pattern.unite(slope.sparsity())
    return ca.Function("variational", [x, S, u, d], ca.cse([rate, ca.project(slope, pattern)]))


def layout(variational: Any) -> str:
    """Return the text of functions of y: how it is `begun` at a state, `advanced` along a slope, and `ended`."""
    places = list(zip(*variational.sparsity_in(1).get_triplet(), strict=True))
    states, M = [f"x[{i}]" for i in range(NX)], NX + len(places)
    slots = {(i, j): f"A[{i}, {j}]" if j < NX else f"B[{i}, {j - NX}]" for i in range(NX) for j in range(NX + NU)}
    values = dict.fromkeys(slots, "0.0") | {place: f"y[{NX + n}]" for n, place in enumerate(places)}
    ended = [f"{state} = y[{i}]" for i, state in enumerate(states)] + [f"{slots[at]} = {values[at]}" for at in slots]
    return _FUNCTIONS.format(
        begun=", ".join(states + ["1.0" if i == j else "0.0" for i, j in places]),
        advanced=", ".join(f"y[{i}] + a * slope[{i}]" for i in range(M)),
        ended="\n    ".join(ended),
    )


_FUNCTIONS = """@merged
def begun(x):
    return ({begun},)


@merged
def advanced(y, a, slope):
    return ({advanced},)


@merged
def ended(y, x, A, B):
    {ended}


"""
