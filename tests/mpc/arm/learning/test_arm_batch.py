"""Many arms in one compiled loop move as one does by the library's formulas, by SciPy's integrator and on MuJoCo."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from allocator import InvalidInput
from allocator.identification import fit, load_dataset
from allocator.joint.gas import Gas
from allocator.mechanism import Link, Mechanism, Sites
from allocator.mechanism.bodies import Bodies
from allocator.muscles import Hildebrandt2005
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N
from allocator.muscles.models.custom import TableMuscle
from allocator.muscles.uncertainty import force_std
from allocator.units import BAR
from mpc.arm.learning.mujoco_batch import MujocoBatch
from mpc.arm.learning.plant import ArmBatch, VariedArm
from mpc.arm.learning.variation import Variation
from mpc.model.arm.model import Arm
from mpc.tracking.qp.step import SlowStep

pytestmark = pytest.mark.compiles

ARM = Arm.machine("arm26")
SITES = Sites(
    0.4,
    [Link(), Link(0, (0.35, 0.0))],
    [
        [(-1, (-0.32, 0.05)), (0, (0.05, 0.04))],
        [(-1, (-0.32, -0.05)), (0, (0.05, -0.04))],
        [(0, (0.0, 0.05)), (1, (0.06, 0.04))],
        [(0, (0.0, -0.05)), (1, (0.06, -0.04))],
    ],
    (0.03, 0.03, 0.07, 0.07),
)
MIXED = Arm(  # unequal muscles, one of them not affine, on sites, in a vertical plane
    Mechanism(SITES, (SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N) * 2, angle_limits=((-0.6, 0.6),) * 2),
    Bodies.rods((0.35, 0.3), (1.0, 0.6), 0.2, (3.0, -9.0)),
)
MJCF = """<mujoco><worldbody><site name="a" pos="-.3 .05 0"/><site name="b" pos="-.3 -.05 0"/>
<body><joint name="hip" axis="0 1 0" damping=".3" range="-40 40"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".01" mass=".6"/>
<site name="c" pos=".05 0 .05"/><site name="d" pos=".05 0 -.05"/><site name="e" pos=".01 0 .04"/>
<body pos=".3 0 0"><joint name="knee" axis="0 1 0" damping=".2" range="-40 40"/>
<geom type="capsule" fromto="0 0 0 .25 0 0" size=".01" mass=".4"/><site name="f" pos=".04 0 .04"/>
</body></body></worldbody><tendon><spatial name="1"><site site="a"/><site site="c"/></spatial>
<spatial name="2"><site site="b"/><site site="d"/></spatial>
<spatial name="3"><site site="e"/><site site="f"/></spatial></tendon></mujoco>"""
READ = Arm.from_mjcf(MJCF, SAROSI_DMSP_20_400N, 0.22, contraction=0.14)
GAS = Gas(1.35, 1.0e5)


def drawn(varied, size, seed=0):
    """States in which all is taut and within the range, commands and torques."""
    rng, arm = np.random.default_rng(seed), varied.arm
    x = np.concatenate(
        [
            rng.uniform(-0.3, 0.3, (size, arm.n)),
            rng.uniform(-1, 1, (size, arm.n)),
            rng.uniform(2.5, 4.5, (size, arm.m)) * BAR,
        ],
        axis=1,
    )
    return x, rng.uniform(2.5, 4.5, (size, arm.m)) * BAR, rng.uniform(-1, 1, (size, arm.n))


@pytest.mark.parametrize("gas", [None, GAS])
@pytest.mark.parametrize("arm", [ARM, MIXED, READ], ids=["pulleys", "sites", "a MuJoCo model"])
def test_the_formula_is_that_of_mechanism_and_bodies(arm, gas):
    """In numbers of `Mechanism` and `Bodies`, which share no text with it; torque and energy follow to 1e-9."""
    import casadi as ca

    varied = VariedArm(arm, gas)
    symbols = varied.symbols()
    rate = ca.Function("rate", list(symbols), [varied.rate(*symbols)])
    n = arm.n
    for x, u, d in zip(*drawn(varied, 20), strict=True):
        q, omega, P = x[:n], x[n : 2 * n], x[2 * n :]
        said = np.asarray(rate(x, u, varied.nominal, d)).ravel()
        torque = arm.mechanism.torque(q, P)
        alpha = np.linalg.solve(arm.bodies.mass_matrix(q), torque - arm.bodies.bias(q, omega) + d)
        assert said[:n] == pytest.approx(omega, abs=1e-15)
        assert arm.bodies.mass_matrix(q) @ said[n : 2 * n] == pytest.approx(
            arm.bodies.mass_matrix(q) @ alpha, rel=1e-9, abs=1e-9
        )
        power = omega @ arm.bodies.mass_matrix(q) @ said[n : 2 * n]  # of the kinetic energy, with that of C
        other = arm.bodies.gravity_torque(q) + np.array(arm.bodies.damping) * omega
        coriolis = arm.bodies.bias(q, omega) - other
        assert power + omega @ coriolis == pytest.approx(omega @ (torque + d - other), abs=1e-9)
        filling = (u - P) / arm.lags
        if gas is not None:
            eps, speed = arm.mechanism.contractions(q), -arm.mechanism.arms(q) @ omega
            for j, (muscle, L) in enumerate(zip(arm.mechanism.muscles, arm.mechanism.routes.rest_length, strict=True)):
                V = muscle.volume(P[j], eps[j], L)
                V_eff = V + gas.kappa * (P[j] + gas.atmosphere) * L * muscle.gain_integral_slope(P[j], eps[j])
                growth = -muscle.gain(P[j], eps[j]) * speed[j]
                filling[j] -= gas.kappa * (P[j] + gas.atmosphere) * growth / V_eff
        assert said[2 * n :] == pytest.approx(filling, rel=1e-9)


@pytest.mark.slow
def test_the_compiled_loop_is_casadi_s_and_scipy_s():
    varied = VariedArm(ARM, GAS)
    x, u, d = drawn(varied, 4)
    batch, slow = ArmBatch(varied, 4, 0.02), ArmBatch(varied, 4, 0.02, compiled=False)
    values = Variation(gains=0.1, lags=0.2, mass=0.2, damping=0.5).draw(varied, 4, np.random.default_rng(0))
    for some in (batch, slow):
        some.x[:], some.v[:] = x, values
        some.advance(u, d)
    assert batch.x == pytest.approx(slow.x, rel=1e-11, abs=1e-11)
    import casadi as ca

    symbols = varied.symbols()
    rate = ca.Function("rate", list(symbols), [varied.rate(*symbols)])
    for i in range(4):
        found = solve_ivp(
            lambda t, y, i=i: np.asarray(rate(y, u[i], values[i], d[i])).ravel(),
            (0, 0.02), x[i], method="DOP853", rtol=1e-11, atol=1e-11,
        ).y[:, -1]  # fmt: skip
        assert batch.x[i] == pytest.approx(found, rel=1e-5, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("gas", [None, GAS])
def test_on_mujoco_the_same_arms_move_alike(gas):
    """Of other strengths, lags, masses and dampings, and one with a slack muscle and one in its end stop."""
    varied = VariedArm(ARM, gas)
    x, u, d = drawn(varied, 4, 1)
    x[1, 4] = u[1, 0] = 0.5 * BAR
    values = Variation(gains=0.1, lags=0.2, mass=0.2, damping=0.5).draw(varied, 4, np.random.default_rng(0))
    batches = ArmBatch(varied, 4, 0.005, compiled=False), MujocoBatch(varied, 4, 0.005)
    for some in batches:
        some.x[:], some.v[:] = x, values
        some.renew(np.ones(4, bool))
        for _ in range(10):
            some.advance(u, d)
    compiled, mujoco = batches
    assert np.abs(compiled.q - mujoco.q).max() < 1e-6
    assert np.abs(compiled.P / mujoco.P - 1).max() < 1e-6


def test_where_nothing_can_be_compiled_arms_move_slowly_and_say_so(monkeypatch):
    def refused(text):
        raise OSError("no place for compiled code")

    monkeypatch.setattr("mpc.codegen.modules.imported", refused)
    varied = VariedArm(ARM)
    with pytest.warns(SlowStep, match="no place for compiled code"):
        batch = ArmBatch(varied, 2, 0.01)
    slow = ArmBatch(varied, 2, 0.01, compiled=False)
    x, u, d = drawn(varied, 2)
    for some in (batch, slow):
        some.x[:] = x
        some.advance(u, d)
    assert (batch.x == slow.x).all()


def test_an_end_stop_holds():
    batch = ArmBatch(VariedArm(ARM), 1, 0.01, compiled=False)
    batch.x[0] = [1.0, 0.0, 6.0, 0.0, *[2.5 * BAR] * 6]  # fast towards 60°
    furthest = 0.0
    for _ in range(30):
        batch.advance(np.full((1, 6), 2.5 * BAR), np.array([[5.0, 0.0]]))
        furthest = max(furthest, batch.q[0, 0])
    assert np.deg2rad(60) < furthest < np.deg2rad(66)


# --- variation --------------------------------------------------------------------------------------------------------


def fitted(scale=1.0):
    """A muscle with the covariance of a fit: the parameters hang together."""
    rng = np.random.default_rng(5)
    values = np.array(list(SAROSI_DMSP_20_400N.parameters.values()))
    mixing = rng.standard_normal((values.size, values.size)) * 0.003 * scale * np.abs(values)
    C = mixing.T @ mixing
    return replace(SAROSI_DMSP_20_400N, covariance=tuple(map(tuple, ((C + C.T) / 2).tolist())))


def test_parameters_are_drawn_from_the_fit_s_covariance():
    muscle = fitted()
    arm = replace(ARM, mechanism=ARM.mechanism.with_muscles((muscle,) * 5 + (SAROSI_DMSP_20_400N,)))
    varied = VariedArm(arm)
    v = Variation(fit=True).draw(varied, 4000, np.random.default_rng(0))
    own = v[:, varied.places["kind 0"]]
    C = np.array(muscle.covariance)
    spread = np.sqrt(np.diag(C))
    assert np.cov(own.T) / np.outer(spread, spread) == pytest.approx(C / np.outer(spread, spread), abs=0.06)
    rest = np.delete(v, np.arange(v.shape[1])[varied.places["kind 0"]], axis=1)
    assert (rest == rest[0]).all()  # what was not fitted, and not asked for, stays
    assert (v == Variation(fit=True).draw(varied, 4000, np.random.default_rng(0))).all()


def test_factors_are_drawn_as_wide_as_told():
    varied = VariedArm(ARM)
    v = Variation(gains=0.05, lags=0.1, mass=0.2, damping=0.3).draw(varied, 5000, np.random.default_rng(1))
    assert v[:, varied.places["gains"]].std() == pytest.approx(0.05, rel=0.05)
    for name, width, nominal in (("lags", 0.1, 0.1), ("mass", 0.2, 1.0), ("damping", 0.3, 1.0)):
        assert np.log(v[:, varied.places[name]] / nominal).std() == pytest.approx(width, rel=0.05)


def test_a_variation_without_a_fit_or_a_sense_is_refused():
    with pytest.raises(InvalidInput, match="none of the muscles was fitted"):
        Variation(fit=True).check(VariedArm(ARM))
    with pytest.raises(InvalidInput, match="gains = 5"):
        Variation(gains=5.0)
    table = VariedArm(replace(ARM, mechanism=ARM.mechanism.with_muscles(replace(MEASURED, covariance=np.eye(8)))))
    with pytest.raises(InvalidInput, match="TableMuscle area: its samples have to be numbers, not symbols"):
        table.rate(*table.symbols())
    wide = replace(ARM, mechanism=ARM.mechanism.with_muscles(fitted(1e6)))
    with pytest.raises(InvalidInput, match="does not pull"):
        Variation(fit=True).check(VariedArm(wide))


MEASURED = TableMuscle((0.0, 0.1, 0.2, 0.3), (3e-3, 2.1e-3, 1.2e-3, 0.4e-3), (-190.0, -40.0, 0.0, 5.0))


@pytest.mark.parametrize("muscle", [TONDU_DMSP_20_400N, MEASURED])
def test_any_law_can_be_varied(muscle):
    """One that is not affine in the pressure goes through the same formula, and so does a table."""
    varied = VariedArm(replace(ARM, mechanism=ARM.mechanism.with_muscles(muscle)))
    batch = ArmBatch(varied, 2, 0.01, compiled=False)
    batch.x[:, 4:] = 3 * BAR
    batch.v[1, varied.places["gains"]] = 1.1
    batch.advance(np.full((2, 6), 3 * BAR), np.ones((2, 2)))
    assert np.isfinite(batch.x).all()
    assert batch.q[1, 1] < batch.q[0, 1]  # stronger muscles hold harder


def test_wrong_shapes_and_sizes_are_named():
    with pytest.raises(InvalidInput, match="size = 0"):
        ArmBatch(VariedArm(ARM), 0, 0.01, compiled=False)
    with pytest.raises(InvalidInput, match="dt = 10"):
        ArmBatch(VariedArm(ARM), 1, 10, compiled=False)
    batch = ArmBatch(VariedArm(ARM), 2, 0.01, compiled=False)
    with pytest.raises(InvalidInput, match=r"expected \(2, 6\) and \(2, 2\)"):
        batch.advance(np.zeros((1, 6)), np.zeros((2, 2)))
    with pytest.raises(InvalidInput, match="arm is a Mechanism; expected"):
        VariedArm(ARM.mechanism)


def test_arms_are_those_that_a_fit_leaves_possible():
    """Drawn from the fit to the shipped force map, their forces differ as the fit's own standard deviation says."""
    samples = load_dataset("dmsp-20-300-map")
    muscle = fit(Hildebrandt2005, samples.contraction, samples.pressure, samples.force).muscle
    varied = VariedArm(replace(ARM, mechanism=ARM.mechanism.with_muscles(muscle)))
    Variation(fit=True).check(varied)
    v = Variation(fit=True).draw(varied, 2000, np.random.default_rng(2))[:, varied.places["kind 0"]]
    P, eps = 3 * BAR, 0.12
    drawn = muscle.unchecked(list(v.T)).law(P, eps)
    first_order = float(force_std(muscle, P, eps))  # the law is not linear in its parameters
    assert drawn.std() == pytest.approx(first_order, rel=0.15)
    assert drawn.mean() == pytest.approx(muscle.force(P, eps), rel=0.01)
