"""Trials of closed loops: references, simulation, metrics, files and pictures."""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from mpc.observer.filter import CALM_NOISE as CALM_NOISE
    from mpc.tracking.cost import CALM as CALM
    from mpc.trials.files import load_recording as load_recording
    from mpc.trials.files import save_recording as save_recording
    from mpc.trials.files import save_reference as save_reference
    from mpc.trials.files import save_run as save_run
    from mpc.trials.io_systems import at_rest as at_rest
    from mpc.trials.io_systems import closed_loop as closed_loop
    from mpc.trials.io_systems import sampled_controller as sampled_controller
    from mpc.trials.io_systems import sampled_plant as sampled_plant
    from mpc.trials.io_systems import sampled_real_plant as sampled_real_plant
    from mpc.trials.loops import Settings as Settings
    from mpc.trials.loops import loop as loop
    from mpc.trials.margins import Margins as Margins
    from mpc.trials.margins import linear as linear
    from mpc.trials.margins import linear_model as linear_model
    from mpc.trials.motions.arm_trajectories import circle as circle
    from mpc.trials.motions.arm_trajectories import draw as draw
    from mpc.trials.motions.arm_trajectories import hold as hold
    from mpc.trials.motions.arm_trajectories import reach as reach
    from mpc.trials.motions.motion_files import UnusedColumns as UnusedColumns
    from mpc.trials.motions.motion_files import load_motion as load_motion
    from mpc.trials.motions.reference import min_jerk as min_jerk
    from mpc.trials.motions.trajectories import chirp as chirp
    from mpc.trials.motions.trajectories import point_to_point as point_to_point
    from mpc.trials.motions.trajectories import rested_sine as rested_sine
    from mpc.trials.motions.trajectories import steps as steps
    from mpc.trials.motions.trajectories import usual_stiffness as usual_stiffness
    from mpc.trials.other_plant import other_plant as other_plant
    from mpc.trials.pictures.plotting import save_tracking_figure as save_tracking_figure
    from mpc.trials.robust import NotRobust as NotRobust
    from mpc.trials.simulation import in_motion as in_motion
    from mpc.yardsticks.baselines import FeedForwardControl as FeedForwardControl
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
