"""The dead band is the pressure below which a muscle hardly acts: here it is taken from the data, by a stated rule.

A joint is fitted to the samples whose lower pressure is at least 2 bar (or the median, if that is less). Then the dead
band is lowered by 0.25 bar at a time, as long as the samples that this adds are predicted, before they are fitted, to
at most 1.5 times the RMS error of the fit.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.errors import InvalidInput
from allocator.identification.joint.fit import fit_joint
from allocator.identification.joint.result import JointFit
from allocator.identification.joint.samples import JointSamples
from allocator.identification.least_squares import rms
from allocator.units import BAR

_FIRST = 2.0 * BAR
_STEP = 0.25 * BAR
_AS_GOOD = 1.5  # times the error of the fit
_FEWEST = 3  # samples that tell how they are predicted


def estimate_dead_band(theta: ArrayLike, P1: ArrayLike, P2: ArrayLike, **options: Any) -> float:
    """Return the dead band [Pa] that the equilibria show, to 0.25 bar; arguments are those of `fit_joint`.

    Raises InvalidInput for what makes no sense, and where even the highest pressures cannot be fitted.
    """
    options = {name: value for name, value in options.items() if name != "dead_band"}
    low = np.minimum(*checks.broadcast(P1=checks.pressure("P1", P1), P2=checks.pressure("P2", P2))).ravel()
    told = {name: options[name] for name in ("geometry", "torque", "direction", "group") if name in options}
    everything = JointSamples.checked(theta, P1, P2, **told)
    slack = options.get("slack")
    resting = np.ones(low.size, bool) if slack is None else np.ravel(slack) == 0  # the others are of a sag test
    level = float(_STEP * np.floor(min(_FIRST, np.median(low[resting])) / _STEP))
    while level > 0:
        fit = fit_joint(theta, P1, P2, **options | {"dead_band": level, "leave_one_out": False, "choices": False})
        added = everything.where(resting & (low >= level - _STEP) & (low < level))
        if added.n >= _FEWEST and _error(fit, added) > _AS_GOOD * fit.rms:
            break
        level -= _STEP
    return max(level, 0.0)


def _error(fit: JointFit, added: JointSamples) -> float:
    """Return the RMS error [rad] of samples that were not fitted, a missed equilibrium counting as a radian."""
    problem = replace(fit.problem, samples=added)
    _, reached = problem.equilibrium(problem.unknowns(fit.x))
    if fit.samples.groups != added.groups:
        raise InvalidInput("a group has no sample with both pressures above 2 bar: give the dead band")
    return rms(np.where(reached, problem.angle_error(fit.x), 1.0))
