"""Published static models of pneumatic muscles, each named AuthorYear, and a catalogue of parameter sets.

`MODELS` lists the models, `MUSCLES` the named parameter sets. Takosoglu et al. 2016
(exponential in pressure) is missing: its formula was not found.
"""

from allocator.muscles.base import AffineMuscle, Muscle
from allocator.muscles.basis import Basis
from allocator.muscles.cabled import Cabled
from allocator.muscles.catalogue import MUSCLES, SAROSI_DMSP_20_400N
from allocator.muscles.models import MODELS
from allocator.muscles.models.affine import AffinePolynomial, Hildebrandt2005, Hogan1984, Sarosi2012
from allocator.muscles.models.chou import ChouHannaford1996
from allocator.muscles.models.custom import FunctionMuscle, TableMuscle
from allocator.muscles.models.kazemipour import KazemipourKatzschmann2025
from allocator.muscles.models.martens import MartensBoblan2017
from allocator.muscles.models.mckibben import TonduLopez1995
from allocator.muscles.models.polynomial import PolynomialMcKibben
from allocator.muscles.models.pressure_dependent import Andrikopoulos2016, TonduLopez2000
from allocator.muscles.models.threshold import ThresholdPolynomial
from allocator.muscles.models.tondu import Tondu2021
from allocator.muscles.models.wickramatunge import Wickramatunge2010
from allocator.muscles.monotonicity import monotonicity_failure
from allocator.muscles.recipe import Recipe
from allocator.muscles.strength import scaled, strength_powers
from allocator.muscles.uncertainty import (
    ParameterSensitivities,
    force_gradient,
    force_std,
    parameter_sensitivities,
    slope_std,
    standard_deviation,
)

__all__ = [
    "MODELS",
    "MUSCLES",
    "SAROSI_DMSP_20_400N",
    "AffineMuscle",
    "AffinePolynomial",
    "Basis",
    "Andrikopoulos2016",
    "Cabled",
    "ChouHannaford1996",
    "FunctionMuscle",
    "Hildebrandt2005",
    "Hogan1984",
    "KazemipourKatzschmann2025",
    "MartensBoblan2017",
    "Muscle",
    "ParameterSensitivities",
    "PolynomialMcKibben",
    "Recipe",
    "Sarosi2012",
    "TableMuscle",
    "ThresholdPolynomial",
    "Tondu2021",
    "TonduLopez1995",
    "TonduLopez2000",
    "Wickramatunge2010",
    "force_gradient",
    "force_std",
    "monotonicity_failure",
    "parameter_sensitivities",
    "scaled",
    "slope_std",
    "standard_deviation",
    "strength_powers",
]
