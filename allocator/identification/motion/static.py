"""Static angle of a moving joint: its polynomial variable, and the muscles that reproduce it.

It is a polynomial of the equilibrium of a known joint, or of the difference of both pressures. The muscles of a known
joint are corrected so that its equilibria match the log of another joint of its kind.

    minimise  Σ_k (u_k - z - θ_eq(P1_k, P2_k; p))²  +  n w² [(z/z⁰)² + (‖F(p) - F⁰‖/‖F⁰‖)²]    over the zero z and p

z is the encoder's zero beyond the given one, p are the parameters of both muscles, F(p) their forces on a grid of
pressures and contractions and F⁰ those of the given ones; θ_eq balances a known gravity. So properties that the angles
do not determine keep their values, above all the force scale. A zero is hard to distinguish from other muscles, and the
errors come from the model as much as from the sensor: with a smaller w both move far away to gain a few tenths of a
degree. No parameter changes its sign.

If the given muscles were fitted (`covariance`), the stiffness within the range of their fit is held as well, since
angles do not show its scale: a departure by its standard deviation σ_K (at least `_LEAST_STD`) costs as much as an
error of `_HOLD_STIFFNESS`.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from allocator.calculus import Array, falling_root
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles import Muscle
from allocator.units import DEG

_GRID = 36  # pressures per muscle
_LEAST_CONTRACTION = -0.2  # [-]: the law is evaluated up to this extension
_HOLD = 2 * DEG  # w: doubled forces cost as much as an error of this size everywhere
_HOLD_STIFFNESS, _LEAST_STD = 0.3 * DEG, 0.03
_ZERO = 40 * DEG  # z⁰: a zero that costs as much as doubled forces
_SHARES, _CONTRACTIONS = np.meshgrid([1 / 3, 2 / 3, 1.0], [0.0, 0.08, 0.16, 0.24])  # of the supply; [-]
_MOST_CHANGE = 0.9  # of a parameter, relative
_MOST_ZERO = 0.35  # of the encoder [rad]
_HELD_ZERO = 1e-6  # [rad] of a known one
_TURN = np.pi  # [rad] limit of the search
_LEAST_FIRM = 0.25  # of the median stiffness: least divisor of torques
_CLOSE = 1e-7  # [rad] a Newton step after which the next is below rounding


@dataclass(frozen=True)
class Difference:
    """Relative pressure difference q = (P1 - P2)/(P1 + P2 + P_max/2) [-], on which the angle mainly depends."""

    greatest: float  # P_max [Pa]

    def __call__(self, P1: Array, P2: Array) -> Array:
        """Return q (…) [-]."""
        return (P1 - P2) / (P1 + P2 + self.greatest / 2)

    def stiffness(self, P1: Array, P2: Array) -> Array:
        """Return P1 + P2 (…) [Pa], to which the stiffness is about proportional."""
        return np.asarray(P1 + P2)

    def muscles_share(self, P1: Array, P2: Array) -> Array:
        """Return ones (…), see `Equilibrium`: no gravity is known."""
        return np.ones(np.shape(P1))

    def squeezed(self, theta: Array, volume: float) -> tuple[tuple[Array, Array], float]:
        """Return factors of one, see `Equilibrium`: without muscles the volumes are unknown."""
        return (np.ones(theta.size), np.ones(theta.size)), 0.0


@dataclass(frozen=True)
class Equilibrium:
    """Equilibrium angle q [rad] of a joint without load, interpolated on a grid of pressures."""

    joint: AntagonistJoint
    greatest: float  # P_max [Pa]
    gas: bool = True  # whether motion compresses the gas in its muscles
    zero: float = 0.0  # encoder reading at 0 of the joint [rad]
    gravity: Gravity = NO_GRAVITY  # of the link

    def __call__(self, P1: Array, P2: Array) -> Array:
        """Return q (…) [rad]."""
        return self._at(P1, P2, self._grids[0])

    def stiffness(self, P1: Array, P2: Array) -> Array:
        """Return the stiffness (…) [N·m/rad] of the joint at rest, that of gravity included."""
        return self._at(P1, P2, self._grids[1])

    def muscles_share(self, P1: Array, P2: Array) -> Array:
        """Return the muscles' share (…) [-] of that stiffness."""
        if not self.gravity.torque:
            return np.ones(np.shape(P1))
        K = self.stiffness(P1, P2)
        return np.divide(self._at(P1, P2, self._grids[2]), K, out=np.ones(K.shape), where=K > 0)

    def _at(self, P1: Array, P2: Array, grid: Array) -> Array:
        """Return a quantity (…) interpolated bilinearly between its values `grid` (P1, P2), the nearest outside."""
        from scipy.ndimage import map_coordinates

        at = np.stack([P1, P2]) * ((_GRID - 1) / self.greatest)
        return np.asarray(map_coordinates(grid, at, order=1, mode="nearest"))

    def squeezed(self, theta: Array, volume: float) -> tuple[tuple[Array, Array], float]:
        """Return the factors of both absolute pressures for half of each move of `theta`, two rows (n,).

        `theta` (n,) are encoder readings [rad].

        √((V_{k-1}/V_k)^κ), 1 at the first   (G3); and p_a [Pa]. In the middle V is `volume` times that of the joint.
        """
        if not self.gas:
            return (np.ones(theta.size), np.ones(theta.size)), 0.0
        gas, P = self.joint.gas, self.greatest / 2
        low, high = self.joint.geometry.reach
        inside = np.clip(theta - self.zero, max(low, -_TURN), min(high, _TURN))
        squeezed = []
        for side, more in zip(self.joint.sides(inside, (1.0, 1.0)), self.supplement(volume), strict=True):
            log_V = np.log(side.volume(P) + more)
            squeezed.append(np.exp(-gas.kappa / 2 * np.diff(log_V, prepend=log_V[:1])))
        return (squeezed[0], squeezed[1]), gas.atmosphere

    def supplement(self, volume: float) -> tuple[float, float]:
        """Return the gas [m³] to add to each muscle for `volume` times the joint's in the middle of the range."""
        one, two = self.joint.sides(sum(self.joint.angle_range) / 2, (1.0, 1.0))
        P = self.greatest / 2
        return (volume - 1) * float(one.volume(P)), (volume - 1) * float(two.volume(P))

    @cached_property
    def _grids(self) -> tuple[Array, Array, Array]:
        """Return angle [rad], stiffness and the muscles' part of it [N·m/rad] on the grid of pressures.

        Where there are none, they are the nearest.
        """
        from scipy.interpolate import NearestNDInterpolator

        wide = replace(self.joint, angle_limits=None, covariance=None)
        low = min(self.joint.min_contraction, _LEAST_CONTRACTION)
        if all(muscle.min_contraction <= low for muscle in (self.joint.agonist, self.joint.antagonist)):
            wide = replace(wide, min_contraction=low)
        P = np.linspace(0.0, self.greatest, _GRID)
        P1, P2 = np.meshgrid(P, P, indexing="ij")
        theta = wide.equilibrium(P1, P2, gravity=self.gravity)
        known = np.isfinite(theta)
        if known.mean() < 0.5:
            raise InvalidInput(
                f"joint rests nowhere at {1 - known.mean():.0%} of the pressures up to {self.greatest:.3g} Pa: it is "
                "not the joint of this log"
            )
        muscles = wide.stiffness(theta[known], P1[known], P2[known])
        found = np.full((*theta.shape, 3), np.nan)
        found[known] = np.stack([theta[known], muscles + self.gravity.stiffness(theta[known]), muscles], axis=-1)
        nearest = NearestNDInterpolator(np.stack([P1[known], P2[known]], axis=1), found[known])
        there = np.where(known[..., None], found, nearest(P1, P2))
        return there[..., 0], there[..., 1], there[..., 2]


def fit_muscles(
    joint: AntagonistJoint, u: Array, P1: Array, P2: Array, gravity: Gravity = NO_GRAVITY, hold_zero: bool = False
) -> tuple[Muscle, Muscle, float]:
    """Return agonist, antagonist and the encoder's zero [rad] with equilibria u (n,) [rad] at P1, P2 (n,) [Pa].

    With `hold_zero` that zero is 0. Raises `InvalidInput` if these are no longer valid muscles.
    """
    from scipy.optimize import least_squares

    m = len(joint.agonist.parameters)
    given = np.array([*joint.agonist.parameters.values(), *joint.antagonist.parameters.values()])

    def muscles(x: Array) -> tuple[Muscle, Muscle]:
        p = given * (1 + x[1:])
        return joint.agonist.unchecked(p[:m].tolist()), joint.antagonist.unchecked(p[m:].tolist())

    def forces(agonist: Muscle, antagonist: Muscle) -> Array:
        P, eps = joint.pressure_limits[1] * _SHARES, _CONTRACTIONS
        with np.errstate(all="ignore"):
            return np.concatenate([agonist.force(P, eps), antagonist.force(P, eps)], axis=None)

    def held(error: Array, x: Array) -> Array:
        changed = (forces(*muscles(x)) - usual) / np.linalg.norm(usual)
        prior = _HOLD * np.sqrt(u.size) * np.append(changed, x[0] / _ZERO)
        stiffer = (_balance(joint, *muscles(x), u - x[0], P1, P2, gravity)[1] - K) * sure if sure.any() else 0 * K
        return np.concatenate([error, prior, _HOLD_STIFFNESS * stiffer]) / DEG

    def residual(x: Array) -> Array:
        return held(u - x[0] - _equilibrium(joint, *muscles(x), u - x[0], P1, P2, gravity), x)

    def torques(x: Array) -> Array:
        return held(_balance(joint, *muscles(x), u - x[0], P1, P2, gravity)[0] / firm, x)

    usual = forces(joint.agonist, joint.antagonist)
    K = _balance(joint, joint.agonist, joint.antagonist, u, P1, P2, gravity)[1]
    firm = np.maximum(K, _LEAST_FIRM * np.median(K))
    sure = _sureness(joint, u, P1, P2, _LEAST_STD * firm)
    most = np.array([_HELD_ZERO if hold_zero else _MOST_ZERO, *[_MOST_CHANGE] * given.size])
    size = np.array([0.05, *[0.2] * given.size])
    x = 0 * size
    for objective in (torques, residual):  # far away the angles of a soft joint jump; torques are smooth
        x = least_squares(objective, x, bounds=(-most, most), x_scale=size, ftol=1e-6, max_nfev=60).x
    agonist, antagonist = map(_valid, (joint.agonist, joint.antagonist), muscles(x))
    return agonist, antagonist, 0.0 if hold_zero else float(x[0])


def _valid(muscle: Muscle, found: Muscle) -> Muscle:
    """Return `muscle` with the parameters of `found`, of which no fit knows the errors."""
    try:
        return replace(muscle.with_parameters(found.parameters), covariance=None)
    except InvalidInput as error:
        raise InvalidInput(f"muscles like this joint's cannot hold the angles of the log: {error}") from None


def _sureness(joint: AntagonistJoint, u: Array, P1: Array, P2: Array, least: Array) -> Array:
    """Return 1/σ_K (n,) [rad/(N·m)] at equilibria u, P1, P2 (n,), with σ_K at `least`; 0 where no fit knows it."""
    if joint.covariance is None:
        return np.zeros(u.size)
    pair, m = (joint.agonist, joint.antagonist), len(joint.agonist.parameters)
    given = np.array([*pair[0].parameters.values(), *pair[1].parameters.values()])

    def stiffness(p: Array) -> Array:
        agonist, antagonist = (one.unchecked(part.tolist()) for one, part in zip(pair, (p[:m], p[m:]), strict=True))
        return _balance(joint, agonist, antagonist, u, P1, P2, NO_GRAVITY)[1]

    steps = 1e-4 * np.diag(np.where(given == 0, 1.0, given))
    slopes = [(stiffness(given + step) - stiffness(given - step)) / (2 * step.sum()) for step in steps]
    variance = np.einsum("in,ij,jn->n", slopes, joint.covariance, slopes)
    low, high = joint.angle_range
    return np.where((low <= u) & (u <= high), 1 / np.maximum(np.sqrt(np.maximum(variance, 0.0)), least), 0.0)


def _equilibrium(
    joint: AntagonistJoint, agonist: Muscle, antagonist: Muscle, start: Array, P1: Array, P2: Array, gravity: Gravity
) -> Array:
    """Return θ_eq (n,) [rad], searched from `start` (n,) [rad]."""
    reach = joint.geometry.reach
    low, high = (np.full(start.size, end) for end in (max(reach[0], -_TURN), min(reach[1], _TURN)))

    def balance(theta: Array) -> tuple[Array, Array]:
        return _balance(joint, agonist, antagonist, theta, P1, P2, gravity)

    return falling_root(balance, np.clip(start, low, high), low, high, _CLOSE)


def _balance(
    joint: AntagonistJoint, agonist: Muscle, antagonist: Muscle, theta: Array, P1: Array, P2: Array, gravity: Gravity
) -> tuple[Array, Array]:
    """Return torques (n,) [N·m] and stiffnesses (n,) [N·m/rad], gravity included, at the angles `theta` (n,) [rad]."""
    l0 = joint.geometry.rest_length
    one = OneMuscle.at_joint(agonist, True, l0, joint.geometry.agonist(theta))
    two = OneMuscle.at_joint(antagonist, False, l0, joint.geometry.antagonist(theta))
    with np.errstate(all="ignore"):
        torque = one.torque(P1) + two.torque(P2) - gravity.moment(theta)
        return torque, one.stiffness(P1) + two.stiffness(P2) + gravity.stiffness(theta)
