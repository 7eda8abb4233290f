"""How the PID of the closed-loop benchmark was tuned: by numerical optimisation, on seeds that are not evaluated.

    python -m benchmarks.closed_loop_tuning

Minimised is the mean RMS error of the angle over the benchmark's moving trajectories and the stiffness step, each
divided by what the issue asks for, on the standard plant; over the logarithms of the four parameters, by Nelder and
Mead's method. A run that comes to its end far off the reference counts as it is.
"""

import numpy as np
from scipy.optimize import minimize

from benchmarks.closed_loop import CASES, PLANTS, figures, run_case
from mpc.baselines import PIDControl, PIDGains
from mpc.observer import Differentiator

SEED = 101
ASKED = {"sine": 0.8, "min-jerk": 0.55, "chirp": 0.45, "stiffness step": 0.6}  # [°]
START = PIDGains(2.5, 22.0, 0.75, 0.008)  # where a coarser search ended
EVALUATIONS = 50


def cost(logarithms: np.ndarray) -> float:
    gains, plant = PIDGains(*np.exp(logarithms).tolist()), PLANTS["standard"]
    controller = PIDControl(plant.nominal, 0.01, plant.known(), gains)
    errors = [
        figures(case, run_case(plant, CASES[case], controller, Differentiator(0.01), SEED)).rms / asked
        for case, asked in ASKED.items()
    ]
    print(gains, f"{np.mean(errors):.4f}", flush=True)
    return float(np.mean(errors))


def main() -> None:
    start = np.log([START.proportional, START.integral, START.derivative, START.filter_time])
    simplex = np.vstack([start, start + np.diag([0.2, 0.2, 0.1, 0.3])])
    found = minimize(
        cost, start, method="Nelder-Mead", options={"maxfev": EVALUATIONS, "initial_simplex": simplex, "xatol": 0.02}
    )
    print("best:", PIDGains(*np.exp(found.x).tolist()), f"cost {found.fun:.4f}")


if __name__ == "__main__":
    main()
