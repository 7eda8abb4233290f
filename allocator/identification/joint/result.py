"""Result of a joint's fit."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.atomic import write_text
from allocator.files.toml import Table
from allocator.identification.joint import report
from allocator.identification.joint.doubt.common_force import (
    CommonForce,
    Prior,
    guided,
    prior_of,
    settle,
    with_free_friction,
)
from allocator.identification.joint.doubt.covariance import Doubt, doubt
from allocator.identification.joint.doubt.prediction import (
    ForceIntervals,
    Prediction,
    angle_std,
    force_intervals,
    predict,
)
from allocator.identification.joint.filing import NOTHING_SAID, Said
from allocator.identification.joint.problem import FITTED_GRAVITY, JointProblem
from allocator.identification.joint.relative import WHY, Quantity, RelativeJoint, stiffness_with_gradient
from allocator.identification.joint.report import GroupError
from allocator.identification.joint.samples import JointSamples
from allocator.identification.joint.search import Unscaled, best_start, minimise, scale_shape, starts
from allocator.identification.least_squares import at_bound, rms
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.geometry import Geometry
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.machine_file import joint_from
from allocator.muscles import Muscle, Recipe
from allocator.presentation.tables import first_of, html_table, number
from allocator.units import DEG, PERCENT

_EXPLAINED = 0.3  # of the scatter of a shape: error of a fit that explains it


@dataclass(frozen=True)
class JointFit:
    """Fitted joint with its uncertainties. Angles are in rad; errors are errors of the angle."""

    shapes: Mapping[str, AntagonistJoint]  # by group; if `scale` is None their forces are correct up to a factor
    scale: float | None  # mean ∂F/∂P of the agonist, its effective area [m²]; None if undetermined
    scale_std: float | None  # its relative standard deviation [-]
    ratio: float  # strength of the antagonist relative to the agonist [-]
    zero: float  # encoder reading at θ = 0 [rad]
    friction: float  # μ [-]; 0 if not fitted
    gravity: Gravity  # of the link, given or fitted: no part of the shapes
    rms: float  # of all samples [rad]
    groups: tuple[GroupError, ...]
    hysteresis_share: float  # of the squared error of the prediction without friction; NaN without both directions
    standard_deviations: Mapping[str, float]  # of the fitted quantities; ± 1.96 of them are the 95 % interval
    doubt: Doubt  # their sources, and the results of alternative choices
    unseen: tuple[str, ...]  # quantities that these data leave open, and changes of the unknowns that move no angle
    common: CommonForce  # to both muscles: determined, or assumed within bounds
    slack: int  # muscles at samples with a modelled force below `taut_min` of the mean
    monotone: bool  # [M] holds on the taut domain of the data
    determinant_positive: bool  # det ∂(T, K)/∂(P1, P2) > 0 holds there, which makes the inverse unique
    warnings: tuple[str, ...]
    problem: JointProblem = field(repr=False)
    x: Array = field(repr=False)  # the unknowns

    @property
    def samples(self) -> JointSamples:
        """Return the samples used; `dropped` counts the others by reason."""
        return self.problem.samples

    @property
    def model(self) -> str:
        """Return the name of the muscle model."""
        return type(self.problem.prototype).__name__

    @property
    def muscle(self) -> Muscle:
        """Return the agonist."""
        return next(iter(self.shapes.values())).agonist

    @property
    def joint(self) -> AntagonistJoint | RelativeJoint:
        """Return the joint; without a known scale it refuses absolute stiffness."""
        if self._several:
            raise InvalidInput(
                f"the fit is of several geometries: take joint_of({' or '.join(map(repr, self.shapes))})"
            )
        return self.joint_of(next(iter(self.shapes)))

    @property
    def _several(self) -> bool:
        """Whether the groups differ in geometry, and are not files of one joint."""
        (_, first), *others = self.samples.groups
        return any(geometry is not first for _, geometry in others)

    def joint_of(self, group: object) -> AntagonistJoint | RelativeJoint:
        """Return the joint of one group of samples."""
        if str(group) not in self.shapes:
            raise InvalidInput(f"there is no group {group!r}; there are {', '.join(self.shapes)}")
        joint = self.shapes[str(group)]
        return RelativeJoint(joint) if self.scale is None else joint

    @property
    def ratio_std(self) -> float:
        """Return the standard deviation of the ratio [-]; 0 if it was not fitted."""
        return self.ratio * self.standard_deviations.get("log_ratio", 0.0)

    @property
    def left_out(self) -> float:
        """Return the RMS angle error [rad] of groups left out of the fit in turn; NaN with one group."""
        squares = [g.left_out**2 * g.samples for g in self.groups]
        return float(np.sqrt(sum(squares) / sum(g.samples for g in self.groups)))

    def errors(self) -> Array:
        """Return the angle measured minus predicted (n,) [rad]."""
        return self.problem.angle_error(self.x)

    def predicted(self) -> Array:
        """Return the predicted angle (n,) [rad], as an encoder reading."""
        return self.samples.theta - self.errors()

    def angle_std(self, *, new_group: bool = False) -> Array:
        """Return the standard deviation (n,) [rad] of a measured angle at the pressures of the samples.

        ± 1.96 of them are the 95 % interval of another measurement: the parameters' uncertainty, and the fit's errors
        of law, friction and reading. With `new_group` for an unmeasured group (another length), with the error of the
        groups left out in turn. Raises InvalidInput if there are none.
        """
        return angle_std(self, self.problem, new_group)

    def predict(
        self,
        P1: ArrayLike,
        P2: ArrayLike,
        *,
        torque: ArrayLike = 0.0,
        direction: ArrayLike = 0.0,
        geometry: Geometry | None = None,
    ) -> Prediction:
        """Return the predicted encoder angles [rad] at pressures [Pa], with their standard deviations.

        `torque` [N·m] and `direction` as in `fit_joint`. A `geometry` that was not fitted is that of a new group, see
        `angle_std`. Raises InvalidInput for invalid arguments.
        """
        return predict(self, P1, P2, torque, direction, geometry)

    def stiffness(self) -> Quantity:
        """Return K (n,) [N·m/rad] at the samples and its gradient.

        Raises InvalidInput if the force scale is unknown.
        """
        if self.scale is None:
            raise InvalidInput(f"stiffness of this joint {WHY}")
        s = self.samples
        value, gradient = np.empty(s.n), np.empty((s.n, 2 * len(self.muscle.parameters)))
        for here, joint in self._by_group():
            value[here], gradient[here] = stiffness_with_gradient(
                joint, s.theta[here] - self.zero, s.P1[here], s.P2[here]
            )
        return Quantity(value, gradient)

    def stiffness_ratio_std(self) -> Array:
        """Return the standard deviation of K/K_ref (n,) [-] at the samples, K_ref as in `RelativeJoint.reference`."""
        std = np.empty(self.samples.n)
        for here, joint in self._by_group():
            s, relative = self.samples, RelativeJoint(joint)
            std[here] = relative.relative_stiffness_std(s.theta[here] - self.zero, s.P1[here], s.P2[here])
        return std

    def stiffness_std(self) -> Array:
        """Return the standard deviation of K (n,) [N·m/rad] at the samples.

        Raises InvalidInput if the scale is unknown.
        """
        K, covariance = self.stiffness(), next(iter(self.shapes.values())).covariance
        if covariance is None:
            raise InvalidInput("this joint has no covariance: its muscles were not fitted")
        return K.std(np.asarray(covariance))

    def forces(self, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike, group: object = None) -> ForceIntervals:
        """Return the forces of both muscles [N] at true angles [rad] and pressures [Pa], with intervals of 95 %.

        If the common force is undetermined they cover all values allowed by physics, or the prior; see `common`. Raises
        InvalidInput if the force scale is unknown.
        """
        if self.scale is None:
            raise InvalidInput(f"forces of this joint {WHY}")
        joint = self.joint if group is None else self.joint_of(group)
        assert isinstance(joint, AntagonistJoint)  # its scale is known
        return force_intervals(self, joint, theta, P1, P2)

    def _by_group(self) -> list[tuple[Mask, AntagonistJoint]]:
        return [(self.samples.group == i, joint) for i, joint in enumerate(self.shapes.values())]

    def to_dict(self) -> dict[str, object]:
        """Return the fit in one row of a table, ``pandas.DataFrame([f.to_dict() for f in fits])``.

        Parameters are in SI units.
        """
        std = self.standard_deviations
        return {
            "model": self.model,
            "samples": self.samples.n,
            "rms_error_deg": self.rms / DEG,
            "left_out_deg": self.left_out / DEG,
            "encoder_zero_deg": self.zero / DEG,
            "encoder_zero_std_deg": std.get("zero", 0.0) / DEG,
            "gravity_torque": self.gravity.torque,
            "gravity_torque_std": self.gravity_std[0],
            "hanging_angle_deg": self.gravity.hanging / DEG,
            "hanging_angle_std_deg": self.gravity_std[1] / DEG,
            "friction": self.friction,
            "friction_std": std.get("friction", 0.0),
            "antagonist_ratio": self.ratio,
            "antagonist_ratio_std": self.ratio_std,
            "force_scale": self.scale,
            "force_scale_std": self.scale_std,
            **{f"{name}_std": std[name] for name in self.problem.free},
        }

    def __repr__(self) -> str:
        """Return the errors of the angles, the fitted numbers other than the muscle's, and the first warning."""
        found = "; ".join(f"{name} {value}" for name, value in self._found().items())
        return f"JointFit of {self.model}: {self._errors()}\n  {found}" + first_of(self.warnings)

    def _repr_html_(self) -> str:
        """Return errors and results as a table for notebooks."""
        return html_table(f"{self.model}: {self._errors()}", self._found().items())

    def _errors(self) -> str:
        left_out = "" if np.isnan(self.left_out) else f", {number(self.left_out / DEG, 2)}° of groups left out in turn"
        return f"RMS {number(self.rms / DEG, 2)}° over {self.samples.n} samples{left_out}"

    def _found(self) -> dict[str, str]:
        std = "" if self.scale_std is None else f" to {number(self.scale_std / PERCENT, 2)} %"
        return {
            "encoder zero": f"{number(self.zero / DEG, 3)}°",
            "friction": number(self.friction, 3),
            "strength of the antagonist": f"{number(self.ratio)} of the agonist's",
            "force scale": "unknown" if self.scale is None else f"known{std}",
        }

    @property
    def gravity_std(self) -> tuple[float, float]:
        """Return the standard deviations of the gravity's amplitude [N·m] and hanging angle [rad]; 0 if not fitted."""
        if FITTED_GRAVITY[0] not in self.problem.names or not self.gravity.torque:
            return 0.0, 0.0
        at = [self.problem.names.index(name) for name in FITTED_GRAVITY]
        C, G, h = self.doubt.covariance[np.ix_(at, at)], self.gravity.torque, self.gravity.hanging
        along, across = np.array([np.cos(h), np.sin(h)]), np.array([-np.sin(h), np.cos(h)]) / G
        return float(np.sqrt(along @ C @ along)), float(np.sqrt(across @ C @ across))

    def save(self, path: str | PathLike[str], group: object = None, said: Said = NOTHING_SAID) -> None:
        """Write the joint (of `group`) as TOML for `load_joint` and every command's --machine.

        Limits, gas and tables that are `said` of the joint stay. Raises InvalidInput if the encoder's zero is beyond
        the search, if μ is significantly negative, as friction would drive the joint, and for muscles that no file may
        hold, such as those of an absurd force at rest length.
        """
        ended = at_bound(self.x, self.problem.lower, self.problem.upper, 1e-5, 1e-2)
        if "zero" in self.problem.names and ended[self.problem.names.index("zero")]:
            raise InvalidInput(
                f"the encoder's zero would be {self.zero / DEG:+.3g}° or more, so nothing was written: subtract the "
                "reading at θ = 0 from the angles, or correct the geometry"
            )
        noise = dict(zip(self.problem.names, np.sqrt(np.diag(self.doubt.formal)).tolist(), strict=True))
        if self.friction < -max(report.NO_FRICTION, 4 * noise.get("friction", 0.0)):
            raise InvalidInput(
                f"friction μ = {self.friction:.3g} is negative, which no joint has, so nothing was written: "
                "direction has to be +1 where θ was rising, -1 where falling; turn its sign"
            )
        chosen = self.joint if group is None else self.joint_of(group)
        joint = chosen.shape if isinstance(chosen, RelativeJoint) else chosen
        source: dict[str, str | float] = {
            "samples": self.samples.n,
            "rms_error_deg": round(float(np.degrees(self.rms)), 4),
            "encoder_zero_deg": round(float(np.degrees(self.zero)), 4),
            "encoder_zero_std_deg": round(self.standard_deviations.get("zero", 0.0) / DEG, 4),
        }
        text = said.text(joint, self.gravity, self.scale is not None, source)
        try:
            joint_from(Table.parsed("the fitted joint", text), scale_needed=False)
        except InvalidFile as error:
            raise InvalidInput(
                f"{error}; nothing was written, as no command could read it: these angles and pressures do not tell "
                "the law; measure more of them, or choose another model"
            ) from None
        write_text(path, text)


def first_search(problem: JointProblem, recipe: Recipe[Muscle]) -> Array:
    """Return the unknowns (m,) at the best of all starts, where the search to convergence begins.

    One of them is the shape found from the samples without a weight, scaled by the deflection under the weight. Raises
    InvalidInput if the weight's deflection is lost in the scatter, unless another start explains that scatter.
    """
    wide = guided(with_free_friction(problem))
    tried, fault = list(starts(wide, recipe)), None
    if problem.free and "zero" not in problem.names:  # a held zero hides the laws that are only turned
        freed = wide.with_free_zero()
        found = dict(zip(freed.names, best_start(freed, starts(freed, recipe)).tolist(), strict=True))
        tried.append(np.array([found[name] for name in wide.names]))
    still = problem.samples.torque == 0
    if problem.free and not still.all() and still.sum() > len(wide.names):
        shape = replace(wide.on(still), conventional=True, gravity=NO_GRAVITY)
        try:
            tried.append(scale_shape(wide, best_start(shape, starts(shape, recipe))))
        except Unscaled as error:
            fault = error
    x = best_start(wide, tried)
    if fault is not None and rms(wide.angle_error(x)) > _EXPLAINED * fault.scatter:
        raise fault
    return x[: len(problem.names)]


def solved(
    problem: JointProblem, x: Array, leave_one_out: bool, prior: Muscle | Prior | None, choices: bool
) -> JointFit:
    """Return the fit, searched from `x`, with its uncertainties and warnings."""
    problem, x, common = settle(problem, x, prior_of(problem, prior))
    x, converged = minimise(problem, x)
    u = report.checked(problem, x)
    error = problem.angle_error(x)
    inside = ~at_bound(x, problem.lower, problem.upper, 1e-5, 1e-2)
    doubted = doubt(problem, x, inside, common, choices)
    covariance = doubted.covariance
    joints = report.joints(problem, u, covariance, common.unseen)
    found = report.findings(problem, u, joints.values(), covariance, converged)
    return JointFit(
        shapes=joints,
        scale=None if problem.conventional else problem.mean_area(u).real,
        scale_std=found.scale_std,
        ratio=u.ratio,
        zero=u.zero,
        friction=u.friction,
        gravity=problem.gravity_of(u),
        rms=rms(error),
        groups=report.groups(problem, x, error, leave_one_out),
        hysteresis_share=found.hysteresis_share,
        standard_deviations=dict(zip(problem.names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        unseen=(*common.said, *report.unseen(problem, x)),
        common=common,
        doubt=doubted,
        slack=found.slack,
        monotone=not found.failure,
        determinant_positive=found.determinant_positive,
        warnings=report.warnings(problem, x, u, found),
        problem=problem,
        x=x,
    )
