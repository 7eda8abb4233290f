"""A muscle from measured forces, a joint from measured angles: reading, least squares, covariance, ranking."""

from allocator.identification.datasets import DATASETS, Dataset, load_dataset
from allocator.identification.fitting import fit
from allocator.identification.joint_comparison import compare_joint_models
from allocator.identification.joint_fit import fit_joint
from allocator.identification.joint_reading import read_joint_log
from allocator.identification.joint_result import JointFit
from allocator.identification.planner import plan_joint_experiment
from allocator.identification.ranking import rank_models
from allocator.identification.reading import read_samples
from allocator.identification.relative import RelativeJoint
from allocator.identification.result import Fit, Level, has_closed_form_inverse
from allocator.identification.samples import Samples

__all__ = [
    "DATASETS",
    "Dataset",
    "Fit",
    "JointFit",
    "Level",
    "RelativeJoint",
    "Samples",
    "compare_joint_models",
    "fit",
    "fit_joint",
    "has_closed_form_inverse",
    "load_dataset",
    "plan_joint_experiment",
    "rank_models",
    "read_joint_log",
    "read_samples",
]
