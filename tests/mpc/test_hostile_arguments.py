"""Wrong arguments of plants, observers, controllers and their trials: one sentence, no traceback and no nonsense."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import DEG, InvalidInput, feasibility_map, named_muscle, report_joint, save_machine
from allocator.identification import fit_motion
from mpc import (
    Arm,
    Compensation,
    KalmanObserver,
    Plant,
    RealPlant,
    Reference,
    TrackingMPC,
    Weights,
    margins,
    robust_weights,
    simulate,
    sine,
    tune,
)
from mpc.export import export
from mpc.model import Friction, MaxwellSlip
from mpc.trials import circle, closed_loop, point_to_point, sampled_controller, sampled_plant, sampled_real_plant
from mpc.trials.motions.trajectories import chirp, jumps, steps, stiffness_ramps, stiffness_step, together

PLANT = Plant()
ARM = Arm.machine("arm26")
SLIP = MaxwellSlip.of_width(PLANT, 0.1)
NAN = float("nan")


def observer(plant=PLANT, dt=0.01, **others):
    return KalmanObserver(plant, dt, compiled=False, **others)


def controller(**others):
    return TrackingMPC(PLANT, compiled=False, **others)


def short():
    return Reference(np.array([0, 0.1]), np.array([0.1, 0.1]), np.array([7.5, 7.5]))


def real(**effects):
    return RealPlant(PLANT, **effects)


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: observer(dt=0), "dt = 0 s has to be a sample time"),
        (lambda: observer(dt=-1), "dt = -1 s has to be a sample time"),
        (lambda: observer(dt="0.01"), "dt = '0.01' is not a number"),
        (lambda: observer(noise=3), "noise = 3 has to be a Noise"),
        (lambda: observer(compensation=3), "compensation = 3 has to be a Compensation"),
        (lambda: observer(gate=3), "gate = 3 has to be a Gate"),
        (lambda: observer(tolerance=-1), "tolerance = -1"),
        (lambda: observer(tolerance=NAN), "tolerance = nan is not finite"),
        (lambda: observer().estimate("x", [2e5, 2e5]), "y = 'x' is not a number or an array"),
        (lambda: observer().estimate([0.1, 0, 2e5, 2e5], {}), "u = {} is not a number or an array"),
        (lambda: sine(frequency=1e6), "frequency = 1e+06 Hz needs over two samples a period, and dt is 0.02 s"),
        (lambda: sine(K_frequency=25), "K_frequency = 25 Hz needs over two samples"),
        (lambda: observer(wait=3), "wait = 3 has to be True or False"),
        (lambda: margins(controller(), None), "observer = None has to be an observer"),
        (lambda: margins(observer(), controller()), "controller = KalmanObserver has to be a controller"),
        (lambda: margins(controller(), observer(dt=0.02)), "dt = 0.02 s of the observer is not the dt = 0.01 s"),
        (lambda: margins(controller(), observer(), (0.1, 7.5)), "postures: an entry = 0.1 has to be a pair"),
        (lambda: margins(controller(), observer(), [(10, 7.5)]), "theta = 10 rad is over a turn"),
        (
            lambda: margins(controller(), observer(), [(3, 7.5)]),
            "theta = 171.9° is outside the joint's range -125.0 … 125.0°",
        ),
        (lambda: margins(controller(), observer(), 5), "postures = 5 has to be a list of pairs"),
        (lambda: margins(controller(), observer(), listen=NAN), "listen = nan is not finite"),
        (lambda: margins(controller(), observer(), listen=1e9), "listen = 1e+09 s has to lie between 0.1 and 60 s"),
        (lambda: robust_weights(Plant(), compensation=3), "compensation = 3 has to be a Compensation"),
        (lambda: short().resampled(0), "dt = 0 s has to be a sample time above 0 s"),
        (lambda: short().resampled(NAN), "dt = nan is not finite"),
        (lambda: tune(None), "plant = None has to be a Plant or an Arm"),
        (lambda: tune(real()), "the model of a RealPlant is its nominal"),
        (lambda: robust_weights(3), "plant = 3 has to be a Plant or an Arm"),
        (lambda: simulate(ARM, controller(), short()), "theta has the shape (2,); this plant takes (M, 2)"),
        (lambda: replace(ARM.mechanism, muscles=("a",) * 6), "muscles: an entry = 'a' has to be a Muscle"),
        (lambda: replace(ARM.mechanism, routes=None), "routes = None has to be Routes"),
        (lambda: sampled_plant(ARM, 0.01), "plant = Arm"),
        (lambda: sampled_plant(PLANT, 0), "dt = 0 s has to be a sample time"),
        (lambda: sampled_real_plant(PLANT, 0.01), "has to be a RealPlant"),
        (lambda: sampled_controller(controller(), observer()), "reference = KalmanObserver"),
        (lambda: closed_loop(PLANT, controller(), short(), observer=observer(dt=0.02)), "dt = 0.02 s of the observer"),
        (lambda: export("never", controller=observer()), "controller = KalmanObserver"),
        (lambda: export("never", controller=PLANT), "has to be a TrackingMPC"),
        (lambda: Weights(theta="1"), "Weights: theta = '1' is not a number"),
        (lambda: Compensation(frictions=3), "frictions = 3 has to be a row of friction models"),
        (lambda: real(force_gains=0.9), "force_gains = 0.9 has to be a row of values"),
        (lambda: real(force_gains=(0.9,)), r"force_gains = (0.9,) has to be m = 2 numbers"),
        (lambda: real(shut="x"), "shut = 'x' has to be a row of values"),
        (lambda: real(pressure_offset=-1), "pressure_offset = -1 has to be a row of values"),
        (lambda: real(torque_profile=(1, 2)), "torque_profile: an entry = 1 has to be a pair (time [s], torque [N·m])"),
        (lambda: real(faults=[3]), "faults: an entry = 3 has to be a Fault"),
        (lambda: Compensation(flow=np.ones(2)), "has to be one number [Pa/s]"),
        (lambda: replace(PLANT, frequency=np.ones(2)), "has to be one number [Hz]"),
        (lambda: Friction(0.1).share("all"), "share = 'all' is not a number"),
        (lambda: SLIP.share(-1), "share = -1 has to be one number that is not negative [-]"),
        (lambda: MaxwellSlip.of_width(ARM, None), "width = None is not a number"),
        (lambda: MaxwellSlip.of_width(ARM, 0.1, joint=-1), "joint = -1 has to be a whole number, 0 or more"),
        (lambda: Friction.of_width(ARM, 0.1, joint=2), "joint = 2 is over 1"),
        (lambda: circle(ARM, size=np.inf), "size = inf is not finite"),
        (lambda: point_to_point("stiff"), "K = 'stiff' is not a number"),
        (lambda: point_to_point(time=0), "time = 0 has to be one number above 0 [s]"),
        (lambda: chirp(duration=0), "duration = 0 has to be one number above 0 [s]"),
        (lambda: chirp(frequencies=1.0), "frequencies = 1.0 has to be two frequencies [Hz]"),
        (lambda: steps(rest=-1), "rest = -1 has to be one number that is not negative [s]"),
        (lambda: stiffness_step(K=6.0), "K = 6.0 has to be two stiffnesses [N·m/rad]"),
        (lambda: stiffness_ramps(height=NAN), "height = nan is not finite"),
        (lambda: together(angle=1j), "angle = 1j"),
        (lambda: fit_motion([0], [0], [0], [0], joint="my.toml"), "joint = 'my.toml' has to be an AntagonistJoint"),
        (lambda: sine(duration=1e300), "a duration of 1e+300 s has over 1e+06 samples"),
        (lambda: jumps(rest=1e300), "samples of 0.01 s"),
        (lambda: jumps(rest=0), "rest = 0 has to be one number above 0 [s]"),
        (lambda: replace(report_joint(), friction=2), "friction = 2 has to be a share of the muscle forces, 0 to 1"),
        (lambda: report_joint().torque([0.1, 0.2], [1e5, 2e5, 3e5], 2e5), "do not broadcast: theta (2,), P1 (3,)"),
        (lambda: report_joint().stiffness(0.1, 2e5, 2e5, amplitude=3), "for degrees multiply by 0.0174"),
        (lambda: named_muscle(3), "name = 3 has to be the name of a muscle"),
        (lambda: save_machine(None, "never.toml"), "machine = None has to be an AntagonistJoint or a Mechanism"),
    ],
)
def test_a_wrong_argument_is_one_sentence(made, said):
    with pytest.raises(InvalidInput) as refused:
        made()
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_controller_with_another_horizon_has_the_usual_blocks():
    assert replace(controller(), N=10).blocks == (1,) * 10


@pytest.mark.parametrize("lags", [[0.1, 0.2], np.array([0.1, 0.2])])
def test_two_lags_may_stand_in_a_list(lags):
    assert Plant(lag=lags) == Plant(lag=(0.1, 0.2))


def test_margins_show_themselves_in_a_line():
    found = margins(controller(), observer(), [(10 * DEG, 7.5)])
    assert repr(found[0]).startswith("Margins: θ = 10°, K = 7.5 N·m/rad: M_s = ")


def test_a_map_shows_itself_in_a_line():
    found = repr(feasibility_map(theta=[-0.5, 0.0, 0.5], K=[7.0, 8.0]))
    assert found == "FeasibilityMap: 3 theta × 2 K, 100% feasible; isobaric stiffness"
