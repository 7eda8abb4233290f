"""List of all muscle models."""

from allocator.muscles.base import Muscle
from allocator.muscles.models.affine import AffinePolynomial, Hildebrandt2005, Hogan1984, Sarosi2012
from allocator.muscles.models.chou import ChouHannaford1996
from allocator.muscles.models.custom import TableMuscle
from allocator.muscles.models.kazemipour import KazemipourKatzschmann2025
from allocator.muscles.models.martens import MartensBoblan2017
from allocator.muscles.models.mckibben import PolynomialMcKibben, TonduLopez1995
from allocator.muscles.models.pressure_dependent import Andrikopoulos2016, TonduLopez2000
from allocator.muscles.models.threshold import ThresholdPolynomial
from allocator.muscles.models.tondu import Tondu2021
from allocator.muscles.models.wickramatunge import Wickramatunge2010

MODELS: dict[str, type[Muscle]] = {
    model.__name__: model
    for model in (
        Hogan1984,
        TonduLopez1995,
        ChouHannaford1996,
        TonduLopez2000,
        Hildebrandt2005,
        Wickramatunge2010,
        Sarosi2012,
        Andrikopoulos2016,
        MartensBoblan2017,
        PolynomialMcKibben,
        Tondu2021,
        KazemipourKatzschmann2025,
        AffinePolynomial,
        ThresholdPolynomial,
        TableMuscle,
    )
}
"""Every model that can be fitted and saved, by name, in the order of publication."""

__all__ = ["MODELS"]
