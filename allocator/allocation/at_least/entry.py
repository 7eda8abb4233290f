"""`allocate_at_least`: the least pressures that are stiff enough, or a proof that none are."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.allocation.at_least import semidefinite
from allocator.allocation.at_least.semidefinite import Floors, Multipliers
from allocator.allocation.box import pivoting
from allocator.allocation.box.arguments import problem_from
from allocator.allocation.box.problem import BoxProblem
from allocator.allocation.box.result import BoxAllocation, vector
from allocator.allocation.relaxation import Nearby
from allocator.allocation.status import Status
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.gas import ISOBARIC, Stiffness, checked_stiffness
from allocator.joint.limits import TAUT, Limits
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.mechanism import Mechanism
from allocator.presentation.tables import number
from allocator.units import BAR

_LEAST = 1e-6  # of the greatest pressure squared: a smaller gap proves that no lower pressures suffice
_ENOUGH = 1e-8  # of the request: a smaller deficit of stiffness is accepted
_BROKEN = (Status.CONFLICT, Status.SLACK, Status.OUTSIDE_JOINT_RANGE, Status.OUTSIDE_LIMITS)


class Infeasibility(NamedTuple):
    """Proof that no pressures of the box give the torques T and K_q ⪰ B_i (`AtLeast.least`).

    With λ and Z_i ⪰ 0 all pressures have λ·τ + Σ ⟨Z_i, K_q⟩ ≤ reach, but the request has ≥ asked > reach:

        y0, M = mechanism.targets_map(q)
        d·y0 + Σ_j max(d·M_j lo_j, d·M_j hi_j) = reach  <  asked = λ·T + Σ ⟨Z_i, B_i⟩

    where d = `direction` is λ and then the upper triangle of Σ Z_i with its off-diagonal entries doubled.
    """

    torque: Array  # λ (n,)
    matrices: tuple[Array, ...]  # Z_i (n, n), of the stiffness and of the margin, if any
    direction: Array  # d (n + n(n+1)/2,), in the order of a `TargetsMap`, its greatest component 1
    reach: float
    asked: float


@dataclass(frozen=True, eq=False)
class AtLeast:
    """Answer for one posture and one least stiffness."""

    allocation: BoxAllocation  # pressures, achieved values and binding limits
    floors: Floors = field(repr=False)
    multipliers: Multipliers | None = field(repr=False)  # of the semidefinite programme

    @property
    def mechanism(self) -> Mechanism:
        """Mechanism."""
        return self.allocation.mechanism

    @property
    def q(self) -> Array:
        """Posture solved for (n,) [rad]: the requested one, within the joints' range."""
        return self.allocation.q

    @property
    def P(self) -> Array:
        """Pressures (m,) [Pa]."""
        return self.allocation.P

    @property
    def T(self) -> Array:
        """Torques that they give (n,) [N·m]."""
        return self.allocation.T

    @property
    def K(self) -> Array:
        """Stiffness that they give (n, n) [N·m/rad]."""
        return self.allocation.K

    @property
    def K_x(self) -> Array:
        """Stiffness of the endpoint (dim, dim) [N/m]. Raises `InvalidInput` without an endpoint."""
        return self.allocation.K_x

    @property
    def least(self) -> tuple[Array, ...]:
        """B_i (n, n) [N·m/rad] of K_q ⪰ B_i: of the stiffness, and of the margin, if any."""
        return self.floors.least

    @property
    def box(self) -> tuple[Array, Array]:
        """Least and greatest pressures (m,) [Pa] that the limits leave."""
        return self.allocation.box

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the limits that bind."""
        return self.allocation.active  # type: ignore[no-any-return]  # of one target

    @cached_property
    def excess(self) -> tuple[float, ...]:
        """Margin of K_q above each floor in the worst direction, relative to the floor; ≥ 0 is met.

        If the stiffness is out of reach, the pressures maximise the least of these.
        """
        return self.floors.excess(self.K)

    @property
    def torque_met(self) -> bool:
        """Whether the torques are met."""
        return bool(self.allocation.torque_met)

    @property
    def enough(self) -> bool:
        """Whether the stiffness is at least the requested one, and the margin kept."""
        return min(self.excess) >= -_ENOUGH

    @property
    def success(self) -> bool:
        """Whether torques and stiffness are met, by pressures proved to be the least."""
        return self.status == Status.EXACT

    @cached_property
    def status(self) -> Status:
        """Outcome: EXACT is met, by the least pressures; TORQUE_ and STIFFNESS_LIMITED are proved."""
        status = Status(self.allocation.status)
        if status in _BROKEN:
            return status
        if self.torque_met and self.enough:
            if not self.gap <= _LEAST:
                return Status.SOLVER_FAILED
            return Status.EXACT if self.allocation.holds else Status.UNSTABLE
        if self.certificate is None:
            return Status.SOLVER_FAILED
        return Status.STIFFNESS_LIMITED if self.torque_met else Status.TORQUE_LIMITED

    @cached_property
    def gap(self) -> float:
        """Σ (P - P_ref)² above a proven bound, relative to the square of the greatest pressure."""
        if self.multipliers is None:
            return np.inf
        programme = self.floors.programme
        cost = np.sum((self.P / self.floors.problem.unit - programme.centre) ** 2)
        return float(max(cost - 2 * semidefinite.bound(programme, self.multipliers), 0.0))

    @cached_property
    def certificate(self) -> Infeasibility | None:
        """Proof that no pressures suffice, or None."""
        n = self.mechanism.n
        if self.multipliers is not None:
            torque = self.multipliers.torque / self.floors.torque_size
            frames = zip(self.multipliers.matrices, self.floors.frames, strict=True)
            return self._proof(torque, [W.T @ Z @ W for Z, W in frames])
        direction = self.allocation.separation.direction  # for torques out of reach it has only the torques
        return None if np.isnan(direction).any() else self._proof(direction[:n], [np.zeros((n, n))] * len(self.least))

    def _proof(self, torque: Array, matrices: list[Array]) -> Infeasibility | None:
        """Return the proof by these multipliers, or None if they prove nothing."""
        n, (y0, M), (lo, hi) = self.mechanism.n, self.floors.given, self.box
        d = self.mechanism.stacked(torque, sum(matrices) * (2 - np.eye(n)))
        size = np.abs(d).max() or 1.0
        d, torque, scaled = d / size, torque / size, tuple(Z / size for Z in matrices)
        reach = float(d @ y0 + np.maximum(d @ M * lo, d @ M * hi).sum())
        floors = sum(float(np.sum(Z * B)) for Z, B in zip(scaled, self.least, strict=True))
        asked = float(torque @ self.floors.torque + floors)
        return Infeasibility(torque, scaled, d, reach, asked) if reach < asked else None

    @property
    def message(self) -> str:
        """Sentence on the achieved values and the limits in the way."""
        in_the_way = f"; in the way: {', '.join(self.active)}" if self.active else ""
        if self.status == Status.EXACT:
            return "torques are met and the stiffness is enough, with the least pressures"
        if self.status == Status.STIFFNESS_LIMITED:
            what = "stiffness" if int(np.argmin(self.excess)) == 0 else "margin of stability"
            return (
                f"the {what} cannot be had with these torques; in the worst direction it is short by "
                f"{number(-100 * min(self.excess), 3)} % of what is asked for{in_the_way}"
            )
        return self.status.advice + ("" if self.status == Status.UNSTABLE else in_the_way)

    def to_dict(self) -> dict[str, object]:
        """Return the answer by name, units in the names."""
        return self.allocation.to_dict() | {"status": self.status.name, "excess": self.excess, "gap": self.gap}

    def __repr__(self) -> str:
        """Show pressures, torques, stiffness and the limits in the way."""
        lines = [
            f"AtLeast {self.status.name}: P = {vector(self.P / BAR)} bar",
            f"  torques {vector(self.T)} N·m, stiffness {vector(self.K)} N·m/rad",
        ]
        lines += [] if self.allocation.endpoint is None else [f"  stiffness {vector(self.K_x)} N/m at the endpoint"]
        return "\n".join(lines if self.success else [*lines, f"  {self.message}"])


_SEVERAL = "at least a stiffness is asked for one posture and one target at a time, not for {}"


def allocate_at_least(
    mechanism: Mechanism,
    theta: ArrayLike,
    K: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
    margin: float | None = None,
) -> AtLeast:
    """Find the least pressures with exactly the torques `T` and at least the stiffness `K`, or prove that none exist.

    Minimises ‖P - P_ref‖² over the box of the limits, subject to τ(P) = T and K(P) ⪰ K: at least as stiff in every
    direction, the ellipse of K inside that of K(P). For affine muscles this is a semidefinite programme. Clarabel
    solves it, its answer is checked, and both outcomes are proved: `AtLeast.gap`, `AtLeast.certificate`.

    Parameters
    ----------
    mechanism
        A mechanism with n joints and m muscles, all affine in the pressure.
    theta
        Posture (n,) [rad], one.
    K
        Least stiffness: a matrix (n, n) [N·m/rad], symmetric and positive definite, its diagonal (n,), of which the
        other entries are then 0, or a number for K times the unit matrix. Of an endpoint that of its dim coordinates
        [N/m]: then K_x ⪰ K, which is K_q ⪰ Jᵀ K J - Γ(f), with any number of joints.
    T
        Torques (n,) [N·m], or a number for every joint; of an endpoint in addition to Jᵀ·force.
    limits, stiffness
        As of `allocate`.
    margin
        If given, also K_q ⪰ margin·1 [N·m/rad]: the posture is stable with this margin.

    Raises
    ------
    InvalidInput
        As `allocate`, and for several postures or targets at once.
    """
    if not isinstance(mechanism, Mechanism):
        raise InvalidInput(f"mechanism is a {type(mechanism).__name__}; expected a Mechanism")
    mechanism.check_affine("at least a stiffness")
    hand = checked_stiffness(stiffness).endpoint
    size, unit = (hand.dim, "N/m") if isinstance(hand, Endpoint) else (mechanism.n, "N·m/rad")
    if np.ndim(theta) > 1:
        raise InvalidInput(_SEVERAL.format(np.shape(theta)[:-1]))
    least = None if margin is None else checks.not_negative("margin", margin, "N·m/rad")
    problem, shape = problem_from(mechanism, theta, _matrix(K, size, unit), T, limits=limits, stiffness=stiffness)
    if shape:
        raise InvalidInput(_SEVERAL.format(shape))
    return _solved(problem, Floors.of(problem, least))


def _matrix(K: object, size: int, unit: str) -> Array:
    """Return a matrix from a diagonal or a number."""
    array = checks.real("K", K, unit)
    if array.ndim > 1:
        return array
    return array[..., None] * np.eye(size) if array.shape in ((), (size,)) else array


def _solved(problem: BoxProblem, floors: Floors) -> AtLeast:
    programme = floors.programme
    found = semidefinite.least(programme)
    if found is not None:
        met = AtLeast(_exact(problem, found[0]), floors, found[1])
        if met.torque_met and met.enough and met.gap <= _LEAST:  # also of an unstable posture, or with a slack muscle
            return met
    beyond = semidefinite.widest(programme)
    if beyond is None:  # unreachable torques: the nearest, and among these the nearest stiffness
        return AtLeast(
            BoxAllocation.of(problem, Nearby.of(problem, pivoting.solve(problem)), (), "exact"), floors, None
        )
    return AtLeast(_exact(problem, beyond[0]), floors, beyond[1])


def _exact(problem: BoxProblem, x: Array) -> BoxAllocation:
    """Return the answer with the pressures nearest to `x` that give the torques."""
    n = problem.mechanism.n
    torques = np.where(np.arange(problem.weights.size) < n, 1.0, 0.0)
    alone = replace(problem, weights=torques, priority="weighted", reference=x[None] * problem.unit)
    return BoxAllocation.of(alone, Nearby.of(alone, pivoting.solve(alone)), (), "clarabel")
