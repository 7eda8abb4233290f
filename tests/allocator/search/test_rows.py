"""Rows of numbers are the curves of the muscles that they were made from, whatever the law."""

from dataclasses import dataclass

import numpy as np
import pytest

from allocator import BAR, AntagonistJoint, InvalidInput, Lever, Limits, Muscle, Pulley, allocate, inverse
from allocator.calculus import cos, exp, sin
from allocator.mechanism import Mechanism
from allocator.muscles import MODELS
from allocator.muscles.basis import Basis
from allocator.search import curves
from allocator.search.arcs import gradient
from allocator.search.batch import rows
from allocator.search.curves import K_T, T_K, T_P, at, pieces
from allocator.search.pairs import nearest
from tests.exact_everywhere.joints import GEOMETRIES, MUSCLES, joint_of, muscle_of

SUPPLY = (0.0, 5 * BAR)
LEVER = Lever(0.25, 0.1655, 0.05094, 0.051)


@dataclass(frozen=True)
class Saturating(Muscle):
    """A stranger's law: a pressure that saturates, and a fibre that softens with it; smooth, of no family here."""

    citation = "made up for this test"

    area: float = 1.2e-3
    P_s: float = 9e5

    def law(self, P, eps):
        """A smooth law that is not affine."""
        fibre = 60.0 * (exp(-8.0 * eps) - 0.45) - 0.5 * self.area * eps * P * exp(-P / 2.5e5)
        return self.area * P / (1 + P / self.P_s) * (1 - 2.4 * eps) + fibre

    def gain(self, P, eps):
        """∂F/∂P"""
        fibre = -0.5 * self.area * eps * (1 - P / 2.5e5) * exp(-P / 2.5e5)
        return self.area / (1 + P / self.P_s) ** 2 * (1 - 2.4 * eps) + fibre


@dataclass(frozen=True)
class Kinked(Saturating):
    """The same, stiffer above 2 bar, with the kink declared or not."""

    declared: float = 1.0

    @property
    def basis(self):
        """Smooth below and above 2 bar."""
        return Basis("smooth", kinks=(2 * BAR,) if self.declared else ())

    def law(self, P, eps):
        """A kink in the pressure."""
        return super().law(P, eps) + 2e-4 * np.maximum(np.real(P) - 2 * BAR, 0) * (1 - 2 * eps)

    def gain(self, P, eps):
        """∂F/∂P"""
        return super().gain(P, eps) + 2e-4 * (np.real(P) >= 2 * BAR) * (1 - 2 * eps)


@dataclass(frozen=True)
class Wavy(Muscle):
    """A smooth law with several bends."""

    citation = "made up for this test"

    waves: float = 3.0  # over 5 bar
    depth: float = 1.2e-3  # of a wave [N/Pa]

    def law(self, P, eps):
        """Waves in the pressure, of other shares in the force and in its slope."""
        w = 2 * np.pi * self.waves / (5 * BAR)
        wave = 0.12 * sin(w * P) * (1 - 1.5 * eps) + 0.25 * (1 - cos(0.7 * w * P)) * eps
        return 1.2e-3 * P * (1 - 2.4 * eps) + self.depth * wave / w + 40 * (exp(-8.0 * eps) - 0.45)

    def gain(self, P, eps):
        """∂F/∂P"""
        w = 2 * np.pi * self.waves / (5 * BAR)
        wave = 0.12 * cos(w * P) * (1 - 1.5 * eps) + 0.175 * sin(0.7 * w * P) * eps
        return 1.2e-3 * (1 - 2.4 * eps) + self.depth * wave


def joint_with(muscle):
    return AntagonistJoint(LEVER, muscle, muscle, angle_limits=(-0.45, 0.45))


STRANGERS = {"lever-a stranger's": Saturating(), "lever-kinked": Kinked(), "lever-wavy": Wavy()}
KNOWN = {f"{g}-{m}": (m, g) for g in ("pulley", "lever-A", "table") for m in MUSCLES}


@pytest.fixture(params=[*KNOWN, *STRANGERS])
def joint(request):
    name = request.param
    return joint_with(STRANGERS[name]) if name in STRANGERS else joint_of(*KNOWN[name])


def test_a_row_gives_torque_stiffness_and_their_slopes(joint):
    theta = np.linspace(*joint.angle_range, 7)
    P = np.linspace(0.02, 0.98, 23) * 5 * BAR
    for side in joint.sides(theta):
        curve = rows(side, *SUPPLY)
        for i in range(theta.size):
            here = side.moved(*(np.broadcast_to(x, theta.shape)[i] for x in side.arrays))
            found = np.array([at(p, curve[i][int(np.searchsorted(curve[i][1:, 3], p, "right"))], T_K) for p in P])
            expected = [getattr(here, f)(P) for f in ("torque", "stiffness", "torque_gain", "stiffness_gain")]
            for values, exact in zip(found.T, expected, strict=True):
                assert values == pytest.approx(exact, abs=3e-11 * np.abs(exact).max() + 1e-18)


def test_on_a_piece_torque_stiffness_and_slope_are_monotone(joint):
    theta = np.linspace(*joint.angle_range, 9)[1:-1]
    for side in joint.sides(theta):
        for curve in rows(side, *SUPPLY):
            for piece in pieces(curve.tolist(), *SUPPLY, T_K):
                segment = curve[int(piece[0])]
                t, k, dt, dk = np.array([at(p, segment, T_K) for p in np.linspace(piece[1], piece[2], 60)]).T
                for values in (t, k, dk[1:-1] / dt[1:-1]):
                    rises = np.diff(values)
                    noise = 1e-9 * np.abs(values).max()
                    assert (rises >= -noise).all() or (rises <= noise).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", STRANGERS)
@pytest.mark.parametrize("priority", ["torque", "stiffness"])
def test_what_a_stranger_s_law_gives_is_met(name, priority):
    joint, rng = joint_with(STRANGERS[name]), np.random.default_rng(3)
    theta = rng.uniform(*joint.angle_range, 30)
    box = joint.pressure_box(theta, Limits(min_force=0.0))
    P1, P2 = (rng.uniform(side.lo, side.hi) for side in box)
    T, K = joint.torque(theta, P1, P2), joint.stiffness(theta, P1, P2)
    keep = (K > 0) & ~box.empty
    a = allocate(theta[keep], K[keep], T[keep], joint=joint, priority=priority)
    assert a.success.all()
    assert (a.gap <= 1e-9).all()


def test_a_law_with_a_kink_that_is_not_declared_is_refused():
    with pytest.raises(InvalidInput, match="kink or a jump in pressure near 2000"):
        allocate(0.1, 5.0, joint=joint_with(Kinked(declared=0.0)))


@dataclass(frozen=True)
class Threshold(Muscle):
    """A smooth law that rises steeply, as tanh, over `width` about 2.5 bar."""

    citation = "made up for this test"

    width: float = 0.1 * BAR

    def law(self, P, eps):
        """Return the force."""
        return (P + 0.3 * BAR * self._tanh(P)) * (3e-3 - 1.1e-2 * eps) - 20 + 0 * eps

    def gain(self, P, eps):
        """Return its derivative by the pressure."""
        return (1 + 0.3 * BAR / self.width * (1 - self._tanh(P) ** 2)) * (3e-3 - 1.1e-2 * eps)

    def _tanh(self, P):
        e = exp(-2 * (P - 2.5 * BAR) / self.width)
        return (1 - e) / (1 + e)


@pytest.mark.slow
@pytest.mark.parametrize("width", [1.0, 0.3, 0.1, 0.02])
def test_a_smooth_law_is_taken_however_steep_it_is(width):
    joint = joint_with(Threshold(width * BAR))
    P1, P2 = np.array([2.9, 2.6, 2.52, 1.1]) * BAR, np.array([2.4, 2.45, 2.49, 3.3]) * BAR
    theta = np.array([0.2, 0.1, 0.0, -0.3])
    T, K = joint.torque(theta, P1, P2), joint.stiffness(theta, P1, P2)
    a = allocate(theta, K, T, joint=joint)
    assert a.success.all()
    assert np.abs(a.T_error).max() < 1e-8
    assert (a.gap <= 1e-9).all()
    mechanism = Mechanism.from_joint(joint)
    assert allocate([0.2], [[K[0]]], [T[0]], joint=mechanism).success


def test_an_edge_that_starts_vertical_does_not_hide_its_optimum():
    # regula falsi between a value that is all but infinite and another one stops at the other one
    goal, segment = (-0.25, 0.2, 1.0, 1.0), (0.0,) * 12
    for m in (1e17, -1e17):
        steep = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, m)
        assert abs(gradient(goal, steep, 0.0, (segment, segment))) <= 0.25 + 0.2


@dataclass(frozen=True)
class FlatStiffness(Muscle):
    """A law with a stiffness that does not depend on the pressure."""

    citation = "made up for this test"

    area: float = 1e-3

    def law(self, P, eps):
        """A parabola of the pressure and a spring."""
        return self.area * (P + 4e-7 * P**2) - 500 * eps + 20

    def gain(self, P, eps):
        """∂F/∂P"""
        return self.area * (1 + 8e-7 * P) + 0 * eps


def test_a_stiffness_that_is_constant_but_for_rounding_leaves_the_torque_free():
    geometry, stops = GEOMETRIES["pulley"]
    joint = AntagonistJoint(geometry, Wavy(1.3), FlatStiffness(), angle_limits=stops)
    a = allocate(1.7388912435990886, 30.0, -60.0, joint=joint, priority="stiffness")
    assert a.P1 == pytest.approx(a.P2) == pytest.approx(5 * BAR)


def test_a_single_pressure_beyond_a_kink_is_answered():
    geometry, stops = GEOMETRIES["table"]
    kinked = muscle_of("Wickramatunge2010")
    joint = AntagonistJoint(geometry, kinked, kinked, angle_limits=stops)
    theta, top = 0.7161790086025401, 4.5 * BAR
    assert kinked.basis.kinks[0] < top
    box = (top, top, 4.0 * BAR, 5.0 * BAR, -np.inf)
    curve = [rows(side, *SUPPLY)[0].tolist() for side in joint.sides(np.array([theta]))]
    P1, P2, gap = nearest(1e3, 0.0, *curve, box, K_T, np.nan, np.nan)
    assert P1 == top
    assert 4.0 * BAR <= P2 <= 5 * BAR
    assert gap == 0


def test_a_stranger_s_inverse_is_found_on_a_pulley():
    joint = AntagonistJoint(Pulley(0.3, 0.02, 0.12), Saturating(), Saturating(), angle_limits=(-1.0, 1.0))
    P1, P2 = 3.1 * BAR, 2.2 * BAR
    found = inverse(0.2, joint.stiffness(0.2, P1, P2), joint.torque(0.2, P1, P2), joint=joint)
    assert np.array(found) == pytest.approx(np.array([P1, P2]), rel=1e-9)


@pytest.mark.slow
def test_all_bends_of_a_wavy_law_are_found_with_few_evaluations(monkeypatch):
    side = joint_with(Wavy()).sides(np.array([0.2293]))[0]
    curve, calls, evaluate = rows(side, *SUPPLY)[0].tolist(), [], curves.polynomial_slope
    monkeypatch.setattr(curves, "polynomial_slope", lambda *a: calls.append(a) or evaluate(*a))
    found = [piece[1] for piece in pieces(curve, *SUPPLY, T_P)][1:]
    P, turns = np.linspace(*SUPPLY, 2001), []
    for what in range(5):
        f = np.array([evaluate(curve[0], what, p)[0] for p in P])
        k = np.flatnonzero(f[:-1] * f[1:] < 0)
        turns += list(P[k] + f[k] / (f[k] - f[k + 1]) * P[1])
    assert len(found) == len(turns) > 10
    assert np.sort(turns) == pytest.approx(np.array(found), abs=P[1] / 10)
    assert len(calls) < 10_000  # 20 ms of plain Python


def test_a_trajectory_without_targets_has_no_pressures():
    assert allocate(np.zeros((0, 3)), 5.0, joint=joint_with(Saturating()), along=0).P1.shape == (0, 3)


def test_every_model_of_the_list_has_a_row():
    assert {name.removesuffix("-report") for name in MUSCLES} >= {model.__name__ for model in MODELS.values()}
    assert len(GEOMETRIES) == 4
