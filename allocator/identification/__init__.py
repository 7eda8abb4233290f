"""A muscle identified from measured forces: reading, least squares, covariance, ranking of models."""

from allocator.identification.datasets import DATASETS, Dataset, load_dataset
from allocator.identification.fitting import fit
from allocator.identification.ranking import rank_models
from allocator.identification.reading import read_samples
from allocator.identification.result import Fit, Level, has_closed_form_inverse
from allocator.identification.samples import Samples

__all__ = [
    "DATASETS",
    "Dataset",
    "Fit",
    "Level",
    "Samples",
    "fit",
    "has_closed_form_inverse",
    "load_dataset",
    "rank_models",
    "read_samples",
]
