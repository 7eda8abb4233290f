"""All models are fitted to the same equilibria: the angle error of each, and the stiffness that it implies.

A good angle fit does not select the stiffness: any rising transformation of the force law leaves the unloaded angles of
a pulley as they are. So the models stay in the order they were given, never ranked on the angle alone, and pairs that
the angles cannot tell apart although their stiffnesses differ are named.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.identification.joint.fit import fit_joint
from allocator.identification.joint.relative import RelativeJoint
from allocator.identification.joint.result import JointFit
from allocator.identification.least_squares import rms
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles import MODELS, Muscle

Model = str | type[Muscle] | Muscle
_TOLD_APART = 0.5  # of the scatter: predictions nearer than this are the same to the data
_DIFFERENT = 0.05  # relative difference of K/K_ref that matters
_LEVELS = (0.5, 1.0, 1.5)  # of the pressure of K_ref


class Twins(NamedTuple):
    """Twins are two models that the angles cannot tell apart."""

    first: str
    second: str
    angle: float  # RMS difference of their predictions [rad]
    stiffness: float  # relative difference of their K/K_ref, exceeded at 5 % of the samples [-]


@dataclass(frozen=True)
class JointComparison:
    """A comparison holds fits by name in the order given, and why other models have none."""

    fits: Mapping[str, JointFit]
    failures: Mapping[str, str]
    stiffness: Mapping[str, Array]  # K/K_ref (3,) at half, once and 1.5 times the pressure of K_ref [-]
    indistinguishable: tuple[Twins, ...]

    @property
    def sentences(self) -> tuple[str, ...]:
        """Return what the angles leave open."""
        return tuple(
            f"{t.first} and {t.second} cannot be told apart by these angles (predictions {np.degrees(t.angle):.2g}° "
            f"apart), but their stiffness relative to the reference differs by {t.stiffness:.0%}"
            for t in self.indistinguishable
        )


def compare_joint_models(
    theta: ArrayLike,
    P1: ArrayLike,
    P2: ArrayLike,
    *,
    models: Iterable[Model] = tuple(MODELS),
    progress: Callable[[Iterable[Model]], Iterable[Model]] = lambda models: models,
    **options: Any,
) -> JointComparison:
    """Fit every model to the same equilibria; `options` go to `fit_joint`. Muscles may stand among the models.

    The comparison itself shows what the choice of law changes: each fit is made without `choices`.
    """
    options = {"choices": False} | options
    fits: dict[str, JointFit] = {}
    failures: dict[str, str] = {}
    for model in progress(tuple(models)):
        kind = model if isinstance(model, str | type) else type(model)
        name = kind if isinstance(kind, str) else kind.__name__
        number = sum(other.partition(" #")[0] == name for other in fits)
        name = f"{name} #{number + 1}" if number else name
        try:
            fits[name] = fit_joint(theta, P1, P2, model=model, **options)
        except InvalidInput as error:
            failures[name] = str(error)
    stiffness = {}
    for name, fit in fits.items():
        relative = RelativeJoint(_first(fit))
        theta, P, _ = relative.reference
        stiffness[name] = relative.relative_stiffness(theta, np.array(_LEVELS) * P, np.array(_LEVELS) * P)
    return JointComparison(fits, failures, stiffness, _twins(fits))


def _first(fit: JointFit) -> AntagonistJoint:
    return next(iter(fit.shapes.values()))


def _twins(fits: Mapping[str, JointFit]) -> tuple[Twins, ...]:
    scatter = min((fit.rms for fit in fits.values()), default=0.0)
    found = []
    for first, second in combinations(fits, 2):
        both = fits[first], fits[second]
        s = min((fit.samples for fit in both), key=lambda s: s.n)  # some laws leave some out
        here = s.group == 0
        one, other = (replace(fit.problem, samples=s).angle_error(fit.x) for fit in both)
        K1, K2 = (
            RelativeJoint(_first(fit)).relative_stiffness(s.theta[here] - fit.zero, s.P1[here], s.P2[here])
            for fit in both
        )
        angle, K = rms(one - other), float(np.quantile(np.abs(K1 / K2 - 1), 0.95))
        if angle <= _TOLD_APART * scatter and K > _DIFFERENT:
            found.append(Twins(first, second, angle, K))
    return tuple(found)
