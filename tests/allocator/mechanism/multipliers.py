"""Optimality conditions of problem [M], with multipliers that the library has no part in."""

import numpy as np


def kkt_by_hand(problem, x):
    """The optimality residual with multipliers of our own: least squares on the free variables, level after level."""
    (_, ends), (lo, hi, centre) = problem.rows, problem.x_bounds
    bounds = [0, *ends]
    worst = np.zeros(len(x))
    for i in range(len(x)):
        A, b = problem.A[problem.which[i]], problem.b[i]
        inside = (x[i] > lo[i] + 1e-9) & (x[i] < hi[i] - 1e-9)
        held = np.zeros(len(lo[i]), bool)
        for k in range(len(ends) + 1):
            g = x[i] - centre[i]
            if k < len(ends):
                rows = slice(bounds[k], bounds[k + 1])
                g = A[rows].T @ (A[rows] @ x[i] - b[rows])
            kept = A[: bounds[min(k, len(ends))]]
            mu = np.linalg.lstsq(kept[:, inside].T, -g[inside], rcond=None)[0] if len(kept) else np.zeros(0)
            G = g + kept.T @ mu
            scale = 1.0 + np.abs(g).max() + (np.abs(kept).T @ np.abs(mu)).max(initial=0.0)
            wrong = np.where(inside, np.abs(G), np.where(x[i] <= lo[i] + 1e-9, -G, G))
            worst[i] = max(worst[i], np.where(held, 0.0, wrong).max() / scale)
            held |= ~inside & (np.abs(G) > 1e-9 * scale)
    return worst
