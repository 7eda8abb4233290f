"""Identification of muscles from forces, of joints from angles at rest, and of their motion from logs."""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from allocator.identification.arm.episodes import ArmLog as ArmLog
    from allocator.identification.arm.episodes import Episode as Episode
    from allocator.identification.arm.episodes import Windows as Windows
    from allocator.identification.arm.episodes import read_arm_log as read_arm_log
    from allocator.identification.arm.fit import ArmFit as ArmFit
    from allocator.identification.arm.fit import assign_muscles as assign_muscles
    from allocator.identification.arm.fit import fit_arm as fit_arm
    from allocator.identification.joint.fit import fit_joint as fit_joint
    from allocator.identification.joint.planning.plan import plan_joint_experiment as plan_joint_experiment
    from allocator.identification.joint.plotting import plot_joint_fit as plot_joint_fit
    from allocator.identification.joint.reading import read_joint_log as read_joint_log
    from allocator.identification.joint.relative import RelativeJoint as RelativeJoint
    from allocator.identification.joint.result import JointFit as JointFit
    from allocator.identification.motion.fit import fit_motion as fit_motion
    from allocator.identification.motion.result import MotionFit as MotionFit
    from allocator.identification.motion.samples import read_motion_log as read_motion_log
    from allocator.identification.muscle.fit import fit as fit
    from allocator.identification.muscle.fit import rank_models as rank_models
    from allocator.identification.muscle.plotting import plot_isobars as plot_isobars
    from allocator.identification.muscle.reading import DATASETS as DATASETS
    from allocator.identification.muscle.reading import Dataset as Dataset
    from allocator.identification.muscle.reading import load_dataset as load_dataset
    from allocator.identification.muscle.reading import read_samples as read_samples
    from allocator.identification.muscle.result import Fit as Fit
    from allocator.identification.muscle.result import Level as Level
    from allocator.identification.muscle.result import has_closed_form_inverse as has_closed_form_inverse
    from allocator.identification.muscle.samples import Samples as Samples
    from allocator.identification.muscle.surface import ForceSurface as ForceSurface
    from allocator.identification.trapped_gas import GasFit as GasFit
    from allocator.identification.trapped_gas import fit_gas as fit_gas
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
