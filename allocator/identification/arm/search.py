"""Least squares for the law of one joint, and the choice of its terms.

    minimise  Σ (q̂_t - q_t)²/deg²  +  λ² w Σ_i ((x_i - x_i⁰)/s_i)²        over x, all windows w and steps t

q̂ is the free run of the joint, its neighbours as measured. The second part holds parameters that the log does not show.
Derivatives are differences of free runs of all changed parameters at once: the motion of a joint that sticks is not
differentiable.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.identification.arm.episodes import Windows
from allocator.identification.arm.law import TERMS, JointLaw, run
from allocator.units import DEG

_HELD = 0.3  # λ [°/°]
_DIFFERENCE = 3e-4  # of a usual size
_ITERATIONS = 40
_BETTER = 0.98  # of the error on left-out episodes that a further term has to reach
_FOLDS = 3


def fit_law(law: JointLaw, windows: Windows, start: Array | None = None) -> Array:
    """Return the parameters (n,) of a joint that predict the windows best."""
    from scipy.optimize import least_squares

    first, size = (np.array([getattr(p, part) for p in law.parameters]) for part in ("start", "size"))
    measured, held = windows.future[..., law.joint], _HELD * np.sqrt(len(windows.q)) / size

    def predicted(x: Array) -> Array:
        return run({law.joint: (law, x)}, windows.q, windows.v, windows.p, windows.step)[law.joint]

    def residual(x: Array) -> Array:
        return np.concatenate([((predicted(x[None])[0] - measured) / DEG).ravel(), held * (x - first)])

    def jacobian(x: Array) -> Array:
        change, n = np.diag(_DIFFERENCE * size), x.size
        rows = predicted(np.concatenate([x + change, x - change])).reshape(2 * n, -1) / DEG
        slope = (rows[:n] - rows[n:]) / (2 * _DIFFERENCE * size[:, None])
        return np.concatenate([slope.T, np.diag(held)])

    begin = first if start is None else start
    fitted = least_squares(residual, begin, jacobian, x_scale=size, max_nfev=_ITERATIONS, ftol=1e-4)
    return np.asarray(fitted.x)


def joint_error(law: JointLaw, x: Array, windows: Windows) -> float:
    """Return the RMS error [rad] of the joint's free runs, its neighbours as measured."""
    predicted = run({law.joint: (law, x[None])}, windows.q, windows.v, windows.p, windows.step)[law.joint][0]
    return float(np.sqrt(np.mean((predicted - windows.future[..., law.joint]) ** 2)))


def folds(windows: Windows, count: int) -> list[NDArray[np.bool_]]:
    """Return which windows (w,) are left out of each of `count` fits: whole episodes, in turn."""
    names = list(dict.fromkeys(windows.episode.tolist()))
    turn = {name: i % count for i, name in enumerate(names)}
    which = np.array([turn[name] for name in windows.episode.tolist()])
    return [which == i for i in range(count)]


def choose_terms(law: JointLaw, windows: Windows, tell: Callable[[str], object] = lambda _: None) -> JointLaw:
    """Return the law with the terms that improve the prediction of left-out episodes, one by one, the best first."""

    def error(law: JointLaw) -> float:
        errors = []
        for out in folds(windows, _FOLDS):
            seen, unseen = windows.only(~out), windows.only(out)
            errors.append(joint_error(law, fit_law(law, seen), unseen))
        return float(np.sqrt(np.mean(np.square(errors))))

    best, left = error(law), list(TERMS)
    while left:
        tried = {term: error(replace(law, terms=(*law.terms, term))) for term in left}
        term = min(tried, key=lambda name: tried[name])
        tell(f"joint {law.joint + 1}: {term} {tried[term] / DEG:.2f}° after {best / DEG:.2f}°")
        if tried[term] > _BETTER * best:
            break
        law, best = replace(law, terms=(*law.terms, term)), tried[term]
        left.remove(term)
    return law
