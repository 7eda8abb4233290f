"""Identification of muscles from forces, of joints from angles at rest, and of their motion from logs."""

from allocator.identification.arm.episodes import ArmLog, Episode, Windows, read_arm_log
from allocator.identification.arm.fit import ArmFit, assign_muscles, fit_arm
from allocator.identification.joint.fit import compare_joint_models, fit_joint
from allocator.identification.joint.planning.plan import plan_joint_experiment
from allocator.identification.joint.plotting import plot_joint_fit
from allocator.identification.joint.reading import read_joint_log
from allocator.identification.joint.relative import RelativeJoint
from allocator.identification.joint.result import JointFit
from allocator.identification.motion.fit import fit_motion
from allocator.identification.motion.result import MotionFit
from allocator.identification.motion.samples import read_motion_log
from allocator.identification.muscle.fit import fit, rank_models
from allocator.identification.muscle.plotting import plot_isobars
from allocator.identification.muscle.reading import DATASETS, Dataset, load_dataset, read_samples
from allocator.identification.muscle.result import Fit, Level, has_closed_form_inverse
from allocator.identification.muscle.samples import Samples
from allocator.identification.muscle.surface import ForceSurface
from allocator.identification.trapped_gas import GasFit, fit_gas

__all__ = [
    "DATASETS",
    "ArmFit",
    "ArmLog",
    "Dataset",
    "Episode",
    "Fit",
    "ForceSurface",
    "GasFit",
    "JointFit",
    "Level",
    "MotionFit",
    "RelativeJoint",
    "Samples",
    "Windows",
    "assign_muscles",
    "compare_joint_models",
    "fit",
    "fit_arm",
    "fit_gas",
    "fit_joint",
    "fit_motion",
    "has_closed_form_inverse",
    "load_dataset",
    "plan_joint_experiment",
    "plot_isobars",
    "plot_joint_fit",
    "rank_models",
    "read_arm_log",
    "read_joint_log",
    "read_motion_log",
    "read_samples",
]
