"""The closed loop: what `antagonist track` has to show, and how the loop bears what it cannot follow."""

import re
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from allocator import BAR, DEG, InvalidInput, allocate
from mpc import PlanStatus, Plant, Reference, Rung, TrackingMPC, simulate, sine
from mpc.trials.metrics import metrics
from mpc.trials.motions.trajectories import LEAD, TRAJECTORIES, jumps
from mpc.trials.pictures.plotting import tracking_figure

pytestmark = pytest.mark.compiles

PLANT = Plant()


@pytest.fixture(scope="module")
def default_run():
    return simulate(PLANT, TrackingMPC(PLANT), sine())


def held(theta_deg, K, seconds=2.5):
    return Reference([0, seconds], np.full(2, theta_deg * DEG), np.full(2, K))


class Steps(Reference):
    """A reference whose values hold until the next sample, as a real step does."""

    def resampled(self, dt):
        t = dt * np.arange(round(self.t[-1] / dt) + 1)
        now = np.searchsorted(self.t, t + 1e-9, side="right") - 1
        return Steps(t, self.theta[now], self.K[now])


def answered(run):
    return np.isfinite(run.u).all() and np.isfinite(run.x).all() and (run.rung == Rung.QP).all()


def hard_limits_kept(run):
    broken = metrics(run).violations
    return broken["commanded pressure"][0] == broken["pressure slew"][0] == broken["pressure"][0] == 0


# --- a sine -----------------------------------------------------------------------------------------------------------


def test_the_sine_is_tracked_within_the_required_errors(default_run):
    m = metrics(default_run)
    assert m.theta_rms <= 0.05  # [°]
    assert m.K_rms <= 0.2  # [%]


def test_on_the_sine_no_limit_is_exceeded_and_both_muscles_are_taut(default_run):
    m = metrics(default_run)
    assert m.limits_kept
    assert m.out_of_reach == 0.0
    assert default_run.forces.min() > 0
    assert m.rungs == {"QP": 1200, "SOFTENED": 0, "PREVIOUS": 0, "ALLOCATION": 0, "HOLD": 0}
    assert (default_run.status == PlanStatus.OPTIMAL).all()
    assert m.at_slew_limit == 0.0


def test_the_share_of_commands_at_the_slew_limit_is_counted():
    run = simulate(PLANT, TrackingMPC(PLANT), jumps(7.0, 25 * DEG))
    steps = np.abs(np.diff(run.u, axis=0)).max(axis=1)
    assert metrics(run).at_slew_limit == pytest.approx(100 * np.mean(steps > 0.999 * PLANT.slew * run.dt), abs=0.5)
    assert 5 < metrics(run).at_slew_limit < 95


def test_the_simulated_motion_is_the_plant_s_by_scipy_s_integration(default_run):
    def rate(t, x, u):
        return PLANT.rate(x, u)

    x = default_run.x[0]
    for k in range(150):
        u = default_run.u[k]
        found = solve_ivp(rate, (0, 0.01), x, args=(u,), rtol=1e-10, atol=[1e-12, 1e-12, 1e-4, 1e-4])
        x = found.y[:, -1]
    np.testing.assert_allclose(x, default_run.x[150], rtol=1e-6)


# --- other settings, other plants -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("N", "dt"), [(10, 0.005), (20, 0.005), (10, 0.01), (40, 0.01), (10, 0.02), (40, 0.02)])
def test_horizon_and_sample_time_hardly_matter_on_a_smooth_trajectory(dt, N):
    run = simulate(PLANT, TrackingMPC(PLANT, dt=dt, N=N), sine(duration=2, ramp=1))
    assert answered(run)
    assert metrics(run).limits_kept
    assert metrics(run).theta_rms < 0.01


@pytest.mark.slow
def test_every_joint_is_tracked(joint):
    K_min, K_max = allocate(np.array([-20, 0, 20]) * DEG, 1.0, 0.0, joint=joint).stiffness_interval
    K = 0.5 * (K_min.max() + K_max.min())
    plant = Plant(joint=joint)
    controller = TrackingMPC(plant, compiled=False)  # a compiler would take longer than the run
    run = simulate(plant, controller, sine(amplitude=20 * DEG, K=K, K_amplitude=0.02 * K, duration=4))
    assert answered(run)
    assert metrics(run).limits_kept
    assert metrics(run).theta_rms < 0.01
    assert metrics(run).K_rms < 0.2


@pytest.mark.parametrize(
    ("plant", "theta_rms"),
    [
        (Plant(lag=0.12), 0.03),
        (Plant(inertia=0.06), 0.06),
        (Plant(gravity_torque=1.0), 1.5),
    ],
    ids=["lag 20 % longer", "inertia 20 % more", "unknown load"],
)
def test_the_loop_is_stable_on_a_plant_that_the_model_does_not_know(plant, theta_rms):
    run = simulate(plant, TrackingMPC(PLANT), sine(duration=5))
    assert answered(run)
    assert hard_limits_kept(run)
    assert metrics(run).theta_rms < theta_rms
    assert abs(run.theta[-1]) < 0.01 * DEG


@pytest.mark.slow
@pytest.mark.parametrize("plant", [Plant(lag=(0.05, 0.2)), Plant(gravity_torque=-4.0), Plant(inertia=5e-4, lag=0.02)])
def test_other_plants_are_tracked_as_well(plant):
    controller = TrackingMPC(plant, compiled=not plant.gravity_torque)  # one run with a load is shorter than to compile
    run = simulate(plant, controller, sine(duration=4))
    assert answered(run)
    assert metrics(run).theta_rms < 0.01


# --- what cannot be followed ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("N", "dt"), [(10, 0.005), (10, 0.01), (20, 0.01), (40, 0.01), (10, 0.02)])
@pytest.mark.parametrize("height", [20, 100])
def test_after_steps_beyond_the_slew_limit_the_joint_comes_to_rest_on_the_reference(N, dt, height):
    steps = Steps([0, 0.3, 1.5, 3.2], np.array([0, height, -height, -height]) * DEG, np.full(4, 7.6))
    run = simulate(PLANT, TrackingMPC(PLANT, N=N, dt=dt), steps)
    assert answered(run)
    assert hard_limits_kept(run)
    assert np.abs(np.diff(run.u, axis=0)).max() == pytest.approx(PLANT.slew * dt)  # the limit was used
    assert run.theta[-1] == pytest.approx(-height * DEG, abs=0.01 * DEG)
    assert abs(run.x[-1, 1]) < 0.01


def test_a_stiffness_step_hardly_moves_the_angle():
    steps = Steps([0, 0.3, 1.5], np.full(3, 20 * DEG), [7.0, 8.0, 8.0])
    run = simulate(PLANT, TrackingMPC(PLANT), steps)
    assert metrics(run).theta_worst < 0.1
    assert run.K[-1] == pytest.approx(8.0, rel=1e-4)


def test_an_unreachable_stiffness_costs_no_angle():
    plant = replace(PLANT, gas=False)  # motion compresses gas beyond the supply
    run = simulate(plant, TrackingMPC(plant), sine(K=12, duration=5))
    assert answered(run)
    assert hard_limits_kept(run)
    assert metrics(run).theta_rms < 0.1
    m = metrics(run)
    assert m.out_of_reach == 100.0
    assert m.moved["stiffness"][0] > 1.0  # [N·m/rad]
    assert m.moved["angle"] == (0.0, "°")
    assert run.K.max() > 10  # as stiff as five bar make it


def test_a_reference_beyond_the_joint_range_is_followed_up_to_its_end():
    right = PLANT.joint.angle_range[1]
    run = simulate(PLANT, TrackingMPC(PLANT), Steps([0, 0.2, 2.5], np.array([90, 140, 140]) * DEG, np.full(3, 7.6)))
    assert hard_limits_kept(run)
    assert run.theta.max() < right + 0.1 * DEG
    assert run.theta[-1] == pytest.approx(right, abs=0.01 * DEG)


@pytest.mark.parametrize(
    "x0",
    [
        [60 * DEG, 0, 2 * BAR, 2 * BAR],
        [-100 * DEG, 5, 0.1 * BAR, 4 * BAR],
        [0, -8, 5 * BAR, 5 * BAR],
        [0, 0, 5.4 * BAR, 4 * BAR],
        [0, 0, -0.2 * BAR, -0.1 * BAR],
    ],
    ids=["away", "away, moving and slack", "moving", "above the supply", "below the supply"],
)
def test_a_start_far_from_the_reference_is_brought_back(x0):
    run = simulate(PLANT, TrackingMPC(PLANT), held(0, 7.6), x0=x0)
    assert answered(run)
    assert metrics(run).violations["pressure slew"][0] == 0
    assert run.theta[-1] == pytest.approx(0, abs=0.01 * DEG)
    assert run.K[-1] == pytest.approx(7.6, rel=1e-4)


def test_a_trajectory_in_full_motion_from_the_start_is_caught_up_with():
    run = simulate(PLANT, TrackingMPC(PLANT), sine(ramp=0, duration=4))
    assert answered(run)
    caught = (run.t > 1) & (run.t < 3.5)
    assert np.abs(run.theta - run.theta_ref)[caught].max() < 0.1 * DEG


# --- figures and pictures ---------------------------------------------------------------------------------------------


def test_the_metrics_are_what_their_names_say(default_run):
    shape = default_run.theta.shape
    u, forces = default_run.u.copy(), default_run.forces.copy()
    u[7, 0] = 5.3 * BAR
    forces[3, 1] = -12.0
    x = default_run.x.copy()
    x[:, 0] = default_run.theta_ref + 0.2 * DEG * np.where(np.arange(shape[0]) % 2, 1, -1)
    spoilt = replace(
        default_run, x=x, u=u, forces=forces, K=1.01 * default_run.K_ref, step_time=np.linspace(0, 1e-3, 1200)
    )
    m = metrics(spoilt)
    assert m.theta_rms == pytest.approx(0.2)
    assert m.theta_worst == pytest.approx(0.2)
    assert m.K_rms == pytest.approx(1.0)
    assert m.violations["commanded pressure"] == (pytest.approx(0.3), "bar")
    jump = (5.3 * BAR - default_run.u[6, 0]) / 0.01 / BAR
    assert m.violations["pressure slew"] == (pytest.approx(jump - 5, rel=0.05), "bar/s")
    assert m.violations["slack muscle"] == (12.0, "N")
    assert m.violations["joint range"] == (0.0, "°")
    assert not m.limits_kept
    assert m.step_median == pytest.approx(0.5, rel=1e-2)
    assert m.step_p99 == pytest.approx(0.99, rel=1e-2)
    first, *others = repr(m).splitlines()
    assert first == "Metrics: angle 0.2° RMS, 0.2° worst; stiffness 1 % RMS, 1 % worst"
    assert re.search(r"limits exceeded: commanded pressure by 0.3 bar, .*, slack muscle by 12 N$", others[0])
    assert others[-1] == "  steps: 1200 QP; 0.5 ms in the median, 0.99 ms in 99 %"


def test_the_metrics_in_words_leave_out_what_did_not_happen(default_run):
    assert [line.strip() for line in repr(metrics(default_run)).splitlines()[1:-1]] == ["limits kept"]


def test_the_picture_names_every_quantity_with_its_unit_and_leaves_pyplot_alone(default_run):
    backend = matplotlib.rcParams._get("backend")
    figure = tracking_figure(default_run)
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels[:3] == ["joint angle θ [°]", "error of θ [°]", "isobaric stiffness K\n[N·m/rad]"]
    assert labels[3:] == ["agonist\n[bar]", "antagonist\n[bar]"]
    assert figure.axes[-1].get_xlabel() == "time [s]"
    assert matplotlib.rcParams._get("backend") == backend
    drawn = figure.axes[0].lines[0].get_ydata()
    np.testing.assert_allclose(drawn, default_run.theta / DEG)


@pytest.mark.parametrize("x0", [[0, 0, 3e5], [0, 0, np.nan, 3e5]])
def test_a_start_that_makes_no_sense_is_refused(x0):
    with pytest.raises(InvalidInput, match="x0"):
        simulate(PLANT, TrackingMPC(PLANT), held(0, 7.6), x0=x0)


def test_progress_is_shown_in_a_terminal_on_request(capfd, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes the captured stream for a terminal
    simulate(PLANT, TrackingMPC(PLANT, N=5), held(0, 7.6, 0.1), progress=True)
    shown = capfd.readouterr()
    assert shown.out == ""
    assert "simulating" in shown.err


def rested(run, rest, still=0.0):
    """A run of 100 steps whose reference rests for `rest` samples: 3° and 3 % off until then, 1° and 2 % afterwards."""
    k = np.arange(101)
    after = k >= rest
    theta_ref, K_ref = np.where(k > rest, 0.1, 0.2) + still * k, np.full(101, 5.0)
    x = np.tile(run.x[:1], (101, 1))
    x[:, 0] = theta_ref + np.where(after, 1.0, 3.0) * DEG
    K = K_ref * np.where(after, 1.02, 1.03)
    few = {name: getattr(run, name)[:100] for name in ("u", "estimate", "step_time", "rung", "status", "moved")}
    return replace(run, t=run.t[:101], x=x, K=K, theta_ref=theta_ref, K_ref=K_ref, forces=run.forces[:101], **few)


def test_errors_after_the_first_rest_count_from_its_last_sample_on(default_run):
    run = rested(default_run, 40)
    m = metrics(run)
    assert m.rest == pytest.approx(40 * run.dt)
    assert m.after_rest == pytest.approx((1.0, 1.0, 2.0, 2.0))
    assert m.theta_worst == pytest.approx(3.0)
    assert 1.0 < m.theta_rms < 3.0
    assert "after the first rest of 0.4 s, angle error 1° RMS" in repr(run)
    assert "after the first rest of 0.4 s, angle error" in run._repr_html_()


@pytest.mark.parametrize(
    ("rest", "still"), [(0, 1e-3), (3, 0.0), (100, 0.0)], ids=["begins in motion", "moves after 0.03 s", "never moves"]
)
def test_without_a_first_rest_all_samples_count(default_run, rest, still):
    run = rested(default_run, rest, still)
    m = metrics(run)
    assert m.rest == 0
    assert m.after_rest == (m.theta_rms, m.theta_worst, m.K_rms, m.K_worst)
    assert "first rest" not in repr(run)


def test_a_change_of_stiffness_ends_the_first_rest_too(default_run):
    run = rested(default_run, 40)
    K_ref = np.where(np.arange(101) > 20, 5.5, 5.0)
    assert metrics(replace(run, K_ref=K_ref)).rest == pytest.approx(20 * run.dt)


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_the_first_rest_of_a_standard_trajectory_is_its_lead(default_run, name):
    wanted = TRAJECTORIES[name].about(5.5).resampled(default_run.dt)
    n = wanted.t.size
    longer = {
        f: np.resize(getattr(default_run, f), (n, *getattr(default_run, f).shape[1:])) for f in ("x", "K", "forces")
    }
    run = replace(default_run, t=wanted.t, theta_ref=wanted.theta, K_ref=wanted.K, **longer)
    assert metrics(run).rest == pytest.approx(LEAD, abs=run.dt)
