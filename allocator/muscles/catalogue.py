"""Named muscles: parameter sets, each with the place where its numbers were read."""

from allocator.muscles.mckibben import TonduLopez1995
from allocator.muscles.sarosi import Sarosi2012
from allocator.muscles.tondu import Tondu2021
from allocator.units import BAR, DEG

TONDU_DMSP_20_400N = Tondu2021.identify(r0=0.0109, alpha0=25.5 * DEG, low=(3 * BAR, 0.225), high=(5 * BAR, 0.275))
"""The report's muscle (Tondu 2021, below (19)): d = -10.5 bar, e = -779 bar², c = 0."""

TONDU_MCKIBBEN = TonduLopez1995(r0=0.01, alpha0=23.5 * DEG)
"""The report's ideal McKibben muscle (Tondu 2021, section 1): 1504 N at 5 bar, ε_max = 0.370."""

SAROSI_DMSP_20_400N = Sarosi2012.from_bar_and_percent(-4.35573, 281.22370, -0.32866, -9.27035, 302.20107, -263.69185)
"""Festo DMSP-20-400N (Sárosi et al. 2012, 2015): 315 … 1507 N at 1 … 5 bar without contraction."""

SAROSI_DMSP_20_200N = Sarosi2012.from_bar_and_percent(
    -4.00180705, 292.4620246, -0.32930845, -9.33564098, 294.0538256, -280.498151
)
"""Festo DMSP-20-200N (Sárosi et al. 2012)."""

MUSCLES = {
    "tondu-dmsp-20-400n": TONDU_DMSP_20_400N,
    "tondu-mckibben": TONDU_MCKIBBEN,
    "sarosi-dmsp-20-400n": SAROSI_DMSP_20_400N,
    "sarosi-dmsp-20-200n": SAROSI_DMSP_20_200N,
}
"""Every named muscle, by the name that the command line takes."""

__all__ = ["MUSCLES", "SAROSI_DMSP_20_200N", "SAROSI_DMSP_20_400N", "TONDU_DMSP_20_400N", "TONDU_MCKIBBEN"]
