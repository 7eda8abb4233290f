"""The force scale added to a fit that had none."""

from dataclasses import replace
from typing import Any

import numpy as np

from allocator.errors import InvalidInput
from allocator.identification.joint.fit import scale_shape, solve
from allocator.identification.joint.problem import CONVENTIONAL_AREA
from allocator.identification.joint.relative import RelativeJoint
from allocator.identification.joint.result import JointFit
from allocator.identification.joint.samples import JointSamples
from allocator.muscles import strength_powers


def from_gain(fit: JointFit, T_P: float, at: tuple[float, float, float], std: float) -> JointFit:
    """From a measured ∂T/∂P1 [N·m/Pa] of a fit of one geometry."""
    if fit.scale is not None:
        raise InvalidInput("the force scale is known already, from the weight in the data")
    if len(fit.shapes) > 1:
        raise InvalidInput("T_P belongs to one geometry; this fit is of several: complete it with weights")
    (label, shape), (theta, P1, P2) = next(iter(fit.shapes.items())), at
    joint = RelativeJoint(shape).with_scale(T_P, (theta - fit.zero, P1, P2), std)
    names, powers = list(shape.agonist.parameters), strength_powers(shape.agonist)
    name, power = next((n, p) for n, p in zip(names, powers, strict=True) if p)
    factor = (joint.agonist.parameters[name] / shape.agonist.parameters[name]) ** (1 / power)
    return fit.replaced(shapes={label: joint}, scale=CONVENTIONAL_AREA * float(factor), scale_std=std / T_P)


def from_weights(fit: JointFit, theta: Any, P1: Any, P2: Any, torque: Any, direction: Any, group: Any) -> JointFit:
    """From equilibria under a weight: everything is fitted again, starting from what is known."""
    problem = fit.problem
    geometries = {g.label: g.geometry for g in problem.samples.groups}
    one = len(geometries) == 1 and group is None
    more = JointSamples.checked(
        theta,
        P1,
        P2,
        geometry=next(iter(geometries.values())) if one else geometries,
        torque=torque,
        direction=direction,
        group=None if one else [str(g) for g in group],
    )
    labels = [g.label for g in problem.samples.groups]
    index = more.group if one else [labels.index(more.groups[i].label) for i in more.group]
    more = replace(more, group=np.asarray(index, np.intp), groups=problem.samples.groups)
    joined = problem.samples.joined(more)
    loaded = replace(problem, samples=joined, conventional=False)
    return solve(loaded, scale_shape(loaded, fit.x))


__all__ = ["from_gain", "from_weights"]
