"""Every model of friction has one interface: numbers and symbols agree, and each may be told to whoever controls."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allocator import BAR, DEG, InvalidInput, PrandtlIshlinskii
from allocator.errors import InvalidFile
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Plant
from mpc.model.compensation import Compensation, FrictionState
from mpc.model.friction.contact import Loads
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip, friction_of
from mpc.model.real import RealPlant
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.cost import Weights
from mpc.trials.loops import CONTROLLERS, Settings, loop
from mpc.trials.motions.reference import Reference, min_jerk
from mpc.trials.simulation import simulate

PLANT = Plant(report_joint(SAROSI_DMSP_20_400N), lag=0.12)
REST = PLANT.at_rest(0.0, 5.5)
OPERATOR = PrandtlIshlinskii((0.4, 0.2, 0.2, 0.2), (1.5 * DEG, 3.5 * DEG, 7.0 * DEG), base=0.4)
MODELS = {
    "Dahl": Friction.of_width(PLANT, 5 * DEG, coulomb=0.05),
    "Maxwell slip": MaxwellSlip.of_width(PLANT, 5 * DEG),
    "operator": MaxwellSlip.of(OPERATOR),
    "operator with a gain": MaxwellSlip.of(PrandtlIshlinskii((0.7, 0.3, 0.2), (0.02, 0.05), base=0.6)),
}
ways = st.lists(st.tuples(st.floats(-10, 10), st.floats(0.5, 4), st.floats(0.5, 4)), min_size=1, max_size=15)


@pytest.fixture(params=MODELS.values(), ids=MODELS)
def model(request):
    return request.param


def followed(model, way):
    """Memories (n, ...) and torques (n,) along `way`, of angles [°] and pressures [bar], from 0 on."""
    memory, before, memories, torques = model.begun(0.0), 0.0, [], []
    for theta, P1, P2 in way:
        contact = Loads.of(PLANT, np.array([theta * DEG, 0.0, P1 * BAR, P2 * BAR]))
        memory, before = model.moved(memory, (theta - before) * DEG, contact), theta
        memories.append(memory)
        torques.append(float(model.torque(memory, contact)))
    return np.array(memories), np.array(torques)


@settings(max_examples=20, deadline=None)
@given(ways)
@pytest.mark.parametrize("name", MODELS)
def test_numbers_and_symbols_agree(name, way):
    model = MODELS[name]
    memory, motion, x = ca.SX.sym("memory", model.size), ca.SX.sym("motion"), ca.SX.sym("x", 4)
    moved = model.moved(memory, motion, Loads.of(PLANT, x))
    symbolic = ca.Function("moved", [memory, motion, x], [moved, model.torque(moved, Loads.of(PLANT, x))])
    state, before = model.begun(0.0), 0.0
    for (theta, P1, P2), torque in zip(way, followed(model, way)[1], strict=True):
        state, found = symbolic(state, (theta - before) * DEG, [theta * DEG, 0.0, P1 * BAR, P2 * BAR])
        before = theta
        assert float(found) == pytest.approx(torque, rel=1e-9, abs=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-10, 10), min_size=2, max_size=15))
@pytest.mark.parametrize("name", MODELS)
def test_a_preview_is_what_follows_sample_by_sample(name, angles):
    model, P = MODELS[name], REST[2:] / BAR
    one_by_one, torques = followed(model, [(a, *P) for a in angles])
    contact = Loads.of(PLANT, np.array([0.0, 0.0, *REST[2:]]))
    at_once = model.along(model.begun(0.0), np.array([0.0, *angles]) * DEG, contact)[1:]
    np.testing.assert_allclose(at_once, one_by_one, rtol=1e-9, atol=1e-12)
    if not getattr(model, "elastic", False) and name != "Dahl":  # whose torques do not depend on the angle
        np.testing.assert_allclose(model.torque(at_once, contact), torques, rtol=1e-9, atol=1e-12)


def test_a_share_of_it_has_a_share_of_the_torque(model):
    way = [(3.0, 2.0, 3.0), (-4.0, 2.5, 2.5), (1.0, 3.0, 2.0)]
    np.testing.assert_allclose(followed(model.share(0.6), way)[1], 0.6 * followed(model, way)[1], rtol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-20, 20), min_size=1, max_size=20))
@pytest.mark.parametrize("operator", [OPERATOR, PrandtlIshlinskii((0.7, 0.3, 0.2), (0.02, 0.05))])
def test_the_torque_is_the_stiffness_times_what_the_closed_inverse_says(operator, angles):
    """T_f = K (H⁻¹[θ] - θ), the inverse being that of the operator, run by itself."""
    theta, P = np.array([0.0, *angles]) * DEG, REST[2:]
    static = operator.inverse.run(theta, float(P.sum()))
    torque = followed(MaxwellSlip.of(operator), [(a / DEG, *P / BAR) for a in theta])[1]
    K = PLANT.stiffness(np.stack([theta, 0 * theta, P[0] + 0 * theta, P[1] + 0 * theta]))
    np.testing.assert_allclose(torque, K * (static - theta), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("gain", [1.0, 0.9])
def test_a_plant_with_the_operator_rests_where_the_operator_says(gain):
    """Against the operator itself, driven by the angles that the muscles alone would hold: what is linearised is K."""
    operator = replace(OPERATOR, weights=tuple(gain * w for w in OPERATOR.weights))
    real = RealPlant(PLANT, friction=operator)
    apart = np.interp(np.arange(0.0, 80.0, 0.1), np.arange(0.0, 81.0, 16.0), [0.0, 0.5, -0.5, 0.3, -0.2, 0.0]) * BAR
    u = np.stack([2.6 * BAR + apart, 2.6 * BAR - apart], axis=1)
    experiment = real.begin(0.1, np.array([0.0, 0.0, 2.6 * BAR, 2.6 * BAR]), 0)
    states = []
    for command in u:
        experiment.advance(command)
        states.append(experiment.x)
    x = np.array(states)
    static = PLANT.joint.equilibrium(x[:, 2], x[:, 3], 0.0)
    expected = operator.run(np.array([0.0, *static]), np.array([5.2 * BAR, *(x[:, 2] + x[:, 3])]))[1:]
    assert np.ptp(x[:, 0]) > 10 * DEG
    assert np.abs(expected - static).max() > 1.5 * DEG
    assert np.sqrt(np.mean((x[:, 0] - expected) ** 2)) < 0.1 * DEG  # half of it is viscous damping


def test_pressures_that_fall_let_springs_slip_that_do_not_move():
    slip = MODELS["Maxwell slip"]
    state = FrictionState(slip)
    full, low = (Loads.of(PLANT, np.array([0.0, 0.0, P * BAR, P * BAR])) for P in (3.0, 1.0))
    state.follow(0.0, full)
    held = state.follow(20 * DEG, full)
    np.testing.assert_allclose(state.follow(20 * DEG, low), held * slip.scale(2 * BAR) / slip.scale(6 * BAR))


# --- told to whoever controls -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("controller", "name"), [*((c, "operator") for c in CONTROLLERS), ("mpc", "Maxwell slip"), ("pid", "Maxwell slip")]
)
def test_every_controller_that_is_told_is_nearer_than_one_that_is_not(controller, name):
    real, t = RealPlant(PLANT, friction=MODELS[name]), np.arange(0.0, 1.3, 0.01)
    move = Reference(t, 15 * DEG * min_jerk((t - 0.2) / 0.8), np.full_like(t, 5.5))

    def rms(told):
        known = Settings(PLANT, N=10, compensation=Compensation(told), weights=Weights.calm())
        driver, observer = loop(controller, known)
        run = simulate(real, driver, move, observer=observer)
        return np.sqrt(np.mean((run.theta - run.theta_ref) ** 2))

    assert rms(real.friction) < 0.6 * rms(Friction())


@pytest.mark.compiles
def test_hysteresis_that_is_known_does_not_look_like_a_torque():
    real = RealPlant(PLANT, friction=MODELS["operator"])
    u = REST[2:] + np.array([0.8, -0.8]) * BAR

    def most(told):
        observer, experiment, d = (
            KalmanObserver(PLANT, 0.01, compensation=Compensation(told)),
            real.begin(0.01, REST, 0),
            [],
        )
        for _ in range(60):
            d.append(observer.estimate(experiment.measure(), u)[1])
            experiment.advance(u)
        return np.abs(d).max()

    assert most(MODELS["operator"]) < most(Friction()) / 3


# --- built, kept and refused ------------------------------------------------------------------------------------------


def test_an_operator_is_taken_as_it_is_by_plants_and_controllers():
    slip = MaxwellSlip.of(OPERATOR)
    assert Compensation(OPERATOR).friction == RealPlant(PLANT, friction=OPERATOR).friction == slip
    assert friction_of(PrandtlIshlinskii()).absent
    joint = replace(PLANT.joint, hysteresis=OPERATOR, friction=0.1)
    assert Compensation.of(joint).friction == slip  # all of the hysteresis, so that μ does not count besides
    assert Compensation.of(replace(joint, hysteresis=None)).friction == Friction(mu=0.1)


def test_a_plant_s_file_keeps_what_controllers_are_told(tmp_path):
    path = tmp_path / "plant.toml"
    Plant(replace(PLANT.joint, hysteresis=OPERATOR)).save(path)
    assert Compensation.load(path) == Compensation(OPERATOR)
    with path.open("a", encoding="utf-8") as file:
        file.write("\n[regulators]\ndead_time = 0.03\ndead_band = 10000.0\nlag_up = 0.1\nlag_down = 0.2\n")
    assert Compensation.load(path) == Compensation(OPERATOR, 0.03, 0.1 * BAR, lag_up=0.1, lag_down=0.2)
    assert Plant.load(path).joint.hysteresis == OPERATOR


@pytest.mark.parametrize(
    ("table", "named"),
    [
        ("[regulators]\ndelay = 0.1", "no delay; it has dead_time, dead_band"),
        ("[regulators]\ndead_time = -0.1", "dead_time = -0.1 has to be"),
        ('[regulators]\ndead_band = "small"', "regulators"),
        ('[regulators]\nlag_up = "short"', "lag_up"),
        ("[regulators]\nlag_down = -0.1", "lag_down"),
        ("[hysteresis]\nweights = [0.5, -0.1]\nthresholds = [0.1]", "negative weight"),
    ],
)
def test_what_a_file_tells_wrongly_is_refused_by_its_name(tmp_path, table, named):
    path = tmp_path / "plant.toml"
    PLANT.save(path)
    with path.open("a", encoding="utf-8") as file:
        file.write(f"\n{table}\n")
    with pytest.raises((InvalidFile, InvalidInput), match=named):
        Compensation.load(path)


@pytest.mark.parametrize("given", [0.1, None, "Dahl", Friction])
def test_what_is_no_model_of_friction_is_refused(given):
    for build in (Compensation, lambda friction: RealPlant(PLANT, friction=friction)):
        with pytest.raises(InvalidInput, match="has to be a Friction, a MaxwellSlip or a PrandtlIshlinskii"):
            build(given)
