"""Published static models of pneumatic muscles, each named AuthorYear, and a catalogue of parameter sets.

`MODELS` lists the models, `MUSCLES` the named parameter sets. Takosoglu et al. 2016
(exponential in pressure) is missing: its formula was not found.
"""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from allocator.muscles.base import AffineMuscle as AffineMuscle
    from allocator.muscles.base import Muscle as Muscle
    from allocator.muscles.basis import Basis as Basis
    from allocator.muscles.cabled import Cabled as Cabled
    from allocator.muscles.catalogue import MUSCLES as MUSCLES
    from allocator.muscles.catalogue import SAROSI_DMSP_20_400N as SAROSI_DMSP_20_400N
    from allocator.muscles.models import MODELS as MODELS
    from allocator.muscles.models.affine import AffinePolynomial as AffinePolynomial
    from allocator.muscles.models.affine import Hildebrandt2005 as Hildebrandt2005
    from allocator.muscles.models.affine import Hogan1984 as Hogan1984
    from allocator.muscles.models.affine import Sarosi2012 as Sarosi2012
    from allocator.muscles.models.chou import ChouHannaford1996 as ChouHannaford1996
    from allocator.muscles.models.custom import FunctionMuscle as FunctionMuscle
    from allocator.muscles.models.custom import TableMuscle as TableMuscle
    from allocator.muscles.models.kazemipour import KazemipourKatzschmann2025 as KazemipourKatzschmann2025
    from allocator.muscles.models.martens import MartensBoblan2017 as MartensBoblan2017
    from allocator.muscles.models.mckibben import PolynomialMcKibben as PolynomialMcKibben
    from allocator.muscles.models.mckibben import TonduLopez1995 as TonduLopez1995
    from allocator.muscles.models.pressure_dependent import Andrikopoulos2016 as Andrikopoulos2016
    from allocator.muscles.models.pressure_dependent import TonduLopez2000 as TonduLopez2000
    from allocator.muscles.models.threshold import ThresholdPolynomial as ThresholdPolynomial
    from allocator.muscles.models.tondu import Tondu2021 as Tondu2021
    from allocator.muscles.models.wickramatunge import Wickramatunge2010 as Wickramatunge2010
    from allocator.muscles.monotonicity import monotonicity_failure as monotonicity_failure
    from allocator.muscles.recipe import Recipe as Recipe
    from allocator.muscles.strength import scaled as scaled
    from allocator.muscles.strength import strength_powers as strength_powers
    from allocator.muscles.uncertainty import ParameterSensitivities as ParameterSensitivities
    from allocator.muscles.uncertainty import force_gradient as force_gradient
    from allocator.muscles.uncertainty import force_std as force_std
    from allocator.muscles.uncertainty import parameter_sensitivities as parameter_sensitivities
    from allocator.muscles.uncertainty import slope_std as slope_std
    from allocator.muscles.uncertainty import standard_deviation as standard_deviation
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
