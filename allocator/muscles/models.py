"""The one list of all models."""

from allocator.muscles.affine_polynomial import AffinePolynomial
from allocator.muscles.base import Muscle
from allocator.muscles.chou import ChouHannaford1996
from allocator.muscles.custom import TableMuscle
from allocator.muscles.hildebrandt import Hildebrandt2005
from allocator.muscles.hogan import Hogan1984
from allocator.muscles.kazemipour import KazemipourKatzschmann2025
from allocator.muscles.martens import MartensBoblan2017
from allocator.muscles.mckibben import TonduLopez1995
from allocator.muscles.polynomial import PolynomialMcKibben
from allocator.muscles.pressure_dependent import Andrikopoulos2016, TonduLopez2000
from allocator.muscles.sarosi import Sarosi2012
from allocator.muscles.tondu import Tondu2021
from allocator.muscles.wickramatunge import Wickramatunge2010

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
        TableMuscle,
    )
}
"""Every model that can be fitted and saved, by name, in the order of publication."""

__all__ = ["MODELS"]
