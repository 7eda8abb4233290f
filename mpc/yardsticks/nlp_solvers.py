"""Solvers of the nonlinear programme in `mpc.yardsticks.shooting`, by name. What they return is a proposal, to be
certified.
"""

from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.errors import MissingBackend
from mpc.yardsticks.shooting import Given, Shooting

_OPTIONS: dict[str, dict[str, Any]] = {
    "ipopt": {
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.tol": 1e-9,
        "ipopt.bound_relax_factor": 0.0,  # a slack of -1e-8 would earn its penalty
        "ipopt.max_iter": 200,
    },
    "fatrop": {"structure_detection": "auto", "fatrop.print_level": 0, "fatrop.tolerance": 1e-9},
}
_WIDENING = 1e-8  # of a bound's size: so much fatrop widens it, without an option; hence bounds are narrowed before


# What CasADi makes of Ctrl-C inside IPOPT: between iterations, and inside a function, which throws nothing else.
_INTERRUPTED = ("User_Requested_Stop", "NonIpopt_Exception_Thrown")


class Proposal(NamedTuple):
    """What a solver says."""

    z: Array
    multipliers: Array  # of g; positive at an upper, negative at a lower bound
    success: bool  # in its own opinion


class NLPSolver:
    """IPOPT or fatrop, as CasADi's wheel brings them, for one `Shooting`."""

    def __init__(self, name: str, shooting: Shooting) -> None:
        import casadi as ca

        if name not in _OPTIONS:
            raise MissingBackend("NLP solver", name, _OPTIONS)
        self.name, self._free = name, ~shooting.equality
        options = {"print_time": False, **_OPTIONS[name]}
        if name == "fatrop":
            options["equality"] = shooting.equality.tolist()
        self._nlp = ca.nlpsol("tracking", name, shooting.problem, options)

    def __call__(self, begun: Array, given: Given) -> Proposal:
        """The answer for the programme of this step, `begun` at a point z."""
        lower, upper = given.lower, given.upper
        if self.name == "fatrop":
            lower, upper = lower + self._widening(lower), upper - self._widening(upper)
        answer, said = self._solved(x0=begun, p=given.p, lbg=lower, ubg=upper)
        z, multipliers = (np.ravel(answer[part].full()) for part in ("x", "lam_g"))
        return Proposal(z, multipliers, bool(said["success"]))

    def _solved(self, **programme: Any) -> tuple[Any, Any]:
        """CasADi's answer and what it says of it. Raises `KeyboardInterrupt`, which CasADi turns into other things."""
        try:
            answer = self._nlp(**programme)
        except RuntimeError as error:
            if "KeyboardInterrupt" in str(error):
                raise KeyboardInterrupt from None
            raise
        said = self._nlp.stats()
        if said["return_status"] in _INTERRUPTED:
            raise KeyboardInterrupt
        return answer, said

    def __deepcopy__(self, memo: dict[int, Any]) -> "NLPSolver":
        """Itself: it remembers nothing from call to call."""
        return self

    def _widening(self, bound: Array) -> Array:
        size = np.where(np.isfinite(bound), np.maximum(1.0, np.abs(bound)), 0.0)
        return np.asarray(self._free * _WIDENING * size)


__all__ = ["NLPSolver", "Proposal"]
