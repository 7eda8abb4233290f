"""Catalogue of named parameter sets, each with the place where its numbers were read."""

from dataclasses import replace

from allocator import checks
from allocator.errors import MissingBackend
from allocator.muscles.base import Muscle
from allocator.muscles.models.affine import Sarosi2012
from allocator.muscles.models.martens import MartensBoblan2017
from allocator.muscles.models.mckibben import TonduLopez1995
from allocator.muscles.models.pressure_dependent import TonduLopez2000
from allocator.muscles.models.tondu import Tondu2021
from allocator.units import BAR, DEG

TONDU_DMSP_20_400N = Tondu2021.identify(r0=0.0109, alpha0=25.5 * DEG, low=(3 * BAR, 0.225), high=(5 * BAR, 0.275))
"""The report's muscle (Tondu 2021, below (19)): d = -10.5 bar, e = -779 bar², c = 0."""

TONDU_MCKIBBEN = TonduLopez1995(r0=0.01, alpha0=23.5 * DEG)
"""The report's ideal McKibben muscle (Tondu 2021, section 1): 1504 N at 5 bar, ε_max = 0.370."""

_DMSP_20 = 0.010  # inner radius [m]: Festo calls the muscles by their inner diameter

SAROSI_DMSP_20_400N = replace(
    Sarosi2012.from_bar_and_percent(-4.35573, 281.22370, -0.32866, -9.27035, 302.20107, -263.69185),
    inner_radius=_DMSP_20,
)
"""Festo DMSP-20-400N (Sárosi et al. 2012, 2015): 315 … 1507 N at 1 … 5 bar without contraction."""

SAROSI_DMSP_20_200N = replace(
    Sarosi2012.from_bar_and_percent(-4.00180705, 292.4620246, -0.32930845, -9.33564098, 294.0538256, -280.498151),
    inner_radius=_DMSP_20,
)
"""Festo DMSP-20-200N (Sárosi et al. 2012)."""

TONDU_LOPEZ_LAAS_ARM = TonduLopez2000.with_constant_k(r0=0.0085, alpha0=20 * DEG, k=1.25)
"""Hand-made muscle of the LAAS arm (Tondu & Lopez 2000; rest length 0.185 m), the same k at every pressure."""

MARTENS_DMSP_20_300 = MartensBoblan2017(
    L0=0.300,
    D0=0.020,
    H0=0.0018,
    theta0=28.6 * DEG - 0.073,  # measured, and the correction in rad
    c0=93.232e6,
    c1=-715.29e6,
    c2=1.5483e9,
    c3=-502.95e6,
)
"""Festo DMSP-20-300 (Martens & Boblan 2017, with the erratum of 2018), rest length 0.300 m."""

MUSCLES = {
    "tondu-dmsp-20-400n": TONDU_DMSP_20_400N,
    "tondu-mckibben": TONDU_MCKIBBEN,
    "sarosi-dmsp-20-400n": SAROSI_DMSP_20_400N,
    "sarosi-dmsp-20-200n": SAROSI_DMSP_20_200N,
    "tondu-lopez-laas-arm": TONDU_LOPEZ_LAAS_ARM,
    "martens-dmsp-20-300": MARTENS_DMSP_20_300,
}
"""Every named muscle, by the name that the command line takes."""

SOURCES = {
    "tondu-dmsp-20-400n": "Tondu 2021, below (19)",
    "tondu-mckibben": "Tondu 2021, section 1",
    "sarosi-dmsp-20-400n": "Sárosi et al. 2012, 2015",
    "sarosi-dmsp-20-200n": "Sárosi et al. 2012",
    "tondu-lopez-laas-arm": "Tondu & Lopez 2000",
    "martens-dmsp-20-300": "Martens & Boblan 2017, erratum 2018",
}
"""Where their numbers were read."""


def named_muscle(name: str) -> Muscle:
    """Return the muscle of this name in the catalogue, or the one in the TOML file of this name.

    Raises `InvalidInput`, `InvalidFile` and `MissingBackend`.
    """
    checks.instance("name", name, str, "the name of a muscle, or of a file")
    if name in MUSCLES:
        return MUSCLES[name]
    if not name.endswith(".toml"):
        raise MissingBackend("muscle", name, [*MUSCLES, "a file ending in .toml"])
    return Muscle.load(name)
