"""Force surface of a muscle from a dense table, with the shape constraints of muscles.

    F(P, ε) = Σ_ij C_ij B_i(P) B_j(ε)                                  tensor product of quadratic B-splines

    minimise  Σ_k (F(P_k, ε_k) - F_k)² + λ ‖second differences of C‖²   over C, subject to

    C_{i+1,j} ≥ C_ij                                       force grows with pressure
    C_{i,j+1} ≤ C_ij                                       and falls with contraction
    C_{i,j} - C_{i,j+1} ≤ C_{i+1,j} - C_{i+1,j+1}          stiffness -∂F/∂ε grows with pressure, where it pulls

The inequalities on the coefficients are sufficient, since B-splines are not negative, and make one convex QP. The last
kind applies where C_{i,j+1} of a first solution without it is above 2 % of the greatest coefficient, i.e. the muscle
pulls. It is slack up to a pressure that grows with its contraction, so one end of an interval of contractions is slack
at first, and then gains force faster than the other: the slope over the interval falls there on real muscles.

It is not a `Muscle`, and cannot replace a `TableMuscle` in a joint. In P it is quadratic between `pressures` - 1 knots,
so a pair of muscles has (pressures - 2)² pieces with separate optima, 196 at 16 splines, while a law affine in P has
one piece, a closed-form inverse, a QP and C code. It ends at the edges of its table, and needs 40 samples where five
knots of a `TableMuscle` need ten.

The ends of a muscle do not contract. A muscle of a length L other than the measured L_0 is modelled as

    F_L(P, ε) = (a_L/a_0) F(P, ε a_L/a_0),   a_L = 1 - e/L             (S1)

with one number, the end length e. At no contraction it gives the measured growth of force with length on muscles of 10
mm diameter (304, 366, 422, 439 N for 10, 20, 30, 40 cm): e = 40 mm. These forces scatter by up to 6 % around that
growth, because muscles differ. One reading of the other muscle determines its strength:

    F_s(P, ε) = s F_L(P, ε)                                            (S2)
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput

_DEGREE = 2
_SMOOTH = 1e-3  # λ over the mean weight of a coefficient
_RIDGE = 1e-9
_PULLS = 0.02  # of the greatest coefficient
_OTHER, _CALIBRATED = 0.035, 0.023  # of the greatest force: RMS errors at another length, without and with a reading


@dataclass(frozen=True)
class ForceSurface:
    """Force [N] over gauge pressure [Pa] and contraction [-] of a muscle, between the ends of its table."""

    pressure_knots: Array  # [Pa]
    contraction_knots: Array  # [-]
    coefficients: Array  # (pressures, contractions) [N]
    rms: float  # of the table [N]
    scale: float = 1.0  # a_L/a_0 of another length   (S1)
    strength: float = 1.0  # s of another muscle   (S2)
    doubt: float = 0.0  # standard deviation over the greatest force [-] from applying it to another muscle

    @classmethod
    def fit(
        cls,
        contraction: ArrayLike,
        pressure: ArrayLike,
        force: ArrayLike,
        *,
        pressures: int = 10,
        contractions: int = 4,
    ) -> Self:
        """Fit the surface to a table of forces.

        Parameters
        ----------
        contraction, pressure, force
            Contractions [-], gauge pressures [Pa] and forces [N], arrays (n,).
        pressures, contractions
            Numbers of B-splines along both axes, 3 or more.

        Raises
        ------
        InvalidInput
            For arrays of different lengths, fewer samples than coefficients, and a constant axis.
        """
        eps, P = checks.contraction("contraction", contraction), checks.pressure("pressure", pressure)
        F = checks.real("force", force, "N")
        if not eps.shape == P.shape == F.shape or F.ndim != 1:
            raise InvalidInput("contraction, pressure and force have to be rows (n,), one of each for every sample")
        if min(pressures, contractions) <= _DEGREE:
            raise InvalidInput(f"a surface needs {_DEGREE + 1} B-splines or more along each axis")
        if F.size < pressures * contractions or np.ptp(eps) == 0 or np.ptp(P) == 0:
            raise InvalidInput(
                f"{F.size} samples do not tell {pressures} × {contractions} coefficients: vary both pressure and "
                "contraction, or ask for fewer B-splines"
            )
        knots = _knots(P, pressures), _knots(eps, contractions)
        A = _rows(P, eps, *knots)
        C = _solve(A, F, pressures, contractions).reshape(pressures, contractions)
        return cls(*knots, C, float(np.sqrt(np.mean((A @ C.ravel() - F) ** 2))))

    def force(self, pressure: ArrayLike, contraction: ArrayLike) -> Array:
        """Return the force (…) [N]; beyond the table that of its nearest edge."""
        P, eps = np.broadcast_arrays(np.asarray(pressure, float), np.asarray(contraction, float))
        at = eps * self.scale
        rows = _rows(P.ravel(), at.ravel(), self.pressure_knots, self.contraction_knots)
        return np.asarray(self.strength * self.scale * (rows @ self.coefficients.ravel()).reshape(P.shape))

    @property
    def std(self) -> float:
        """Standard deviation of the force [N], from the fit and from applying it to another muscle.

        The second part was seen on one pair of muscles (`benchmarks.real`); others may differ more.
        """
        factor = self.strength * self.scale
        return float(factor * np.hypot(self.rms, self.doubt * self.coefficients.max()))

    def slope(self, pressure: ArrayLike, contraction: ArrayLike) -> Array:
        """Return ∂F/∂ε (…) [N]."""
        P, eps = np.broadcast_arrays(np.asarray(pressure, float), np.asarray(contraction, float))
        at = eps * self.scale
        rows = _rows(P.ravel(), at.ravel(), self.pressure_knots, self.contraction_knots, 1)
        return np.asarray(self.strength * self.scale**2 * (rows @ self.coefficients.ravel()).reshape(P.shape))

    def at_length(self, measured: float, other: float, end_length: float) -> Self:
        """Return the surface of a muscle of length `other`, all in one unit   (S1)

        Raises `InvalidInput` for muscles not longer than their ends.
        """
        if not 0 <= end_length < min(measured, other):
            raise InvalidInput(
                f"end length {end_length:g} has to be less than both lengths, {measured:g} and {other:g}"
            )
        return replace(self, scale=(1 - end_length / other) / (1 - end_length / measured), doubt=_OTHER)

    def calibrated(self, pressure: float, contraction: float, force: float) -> Self:
        """Return the surface of a muscle with the force `force` [N] at one pressure [Pa] and contraction [-]   (S2)

        Raises `InvalidInput` if this surface or that muscle does not pull.
        """
        P, eps = checks.pressure("pressure", pressure), checks.contraction("contraction", contraction)
        own, read = float(self.force(P, eps)), checks.number("force", force, "N")
        if min(own, read) <= 0:
            raise InvalidInput(f"a surface of {own:g} N is not calibrated by a muscle of {read:g} N: both have to pull")
        return replace(self, strength=self.strength * read / own, doubt=_CALIBRATED)


def _knots(x: Array, count: int) -> Array:
    """Return knots of `count` quadratic B-splines whose inner ones halve the distinct values evenly."""
    inner = np.linspace(0.0, 1.0, count - _DEGREE + 1)
    breaks = np.quantile(np.unique(x), inner)
    return np.concatenate([breaks[:1].repeat(_DEGREE), breaks, breaks[-1:].repeat(_DEGREE)])


def _basis(x: Array, knots: Array, order: int = 0) -> Array:
    """Return the B-splines (n, count) at x (n,), or their derivatives, from the nearest edge outside."""
    from scipy.interpolate import BSpline

    count = knots.size - _DEGREE - 1
    splines = BSpline(knots, np.eye(count), _DEGREE)
    return np.asarray(splines(np.clip(x, knots[0], knots[-1]), nu=order))


def _rows(P: Array, eps: Array, P_knots: Array, eps_knots: Array, order: int = 0) -> Array:
    """Return the tensor products (n, pressures · contractions), or their derivatives with respect to ε."""
    one, two = _basis(P, P_knots), _basis(eps, eps_knots, order)
    return np.asarray((one[:, :, None] * two[:, None, :]).reshape(P.size, -1))


def _solve(A: Array, F: Array, rows: int, columns: int) -> Array:
    """Return the coefficients (rows · columns,) of the QP."""
    up, across = np.diff(np.eye(rows), axis=0), np.diff(np.eye(columns), axis=0)
    monotone = np.concatenate([-np.kron(up, np.eye(columns)), np.kron(np.eye(rows), across)])
    bend = np.concatenate(
        [np.kron(np.diff(np.eye(rows), 2, axis=0), np.eye(columns)), np.kron(np.eye(rows), np.diff(across, axis=0))]
    )
    H = A.T @ A
    weight = np.trace(H) / len(H)
    H += weight * (_SMOOTH * bend.T @ bend + _RIDGE * np.eye(len(H)))
    H, b = H / weight, A.T @ F / weight
    C = _least(H, b, monotone).reshape(rows, columns)
    pulls = (C[:-1, 1:] > _PULLS * C.max()).ravel()
    return _least(H, b, np.concatenate([monotone, np.kron(up, across)[pulls]]))


def _least(H: Array, b: Array, G: Array) -> Array:
    """Return argmin ½ xᵀH x - bᵀx (m,) over G x ≤ 0. Raises `InvalidInput` if none is found."""
    from qpsolvers import solve_qp

    x = solve_qp(H, -b, G, np.zeros(len(G)), solver="daqp")
    if x is None:
        raise InvalidInput("no surface of muscle shape comes near these forces")
    return np.asarray(x)
