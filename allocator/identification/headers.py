"""Meaning of column names: quantity and unit, in several languages.

`eps [%]`, `Pressure (kPa)`, `Kraft in N`, `P1_bar` and `p/bar` are all read: the last words are the unit, in brackets
or not, and the words before it are the quantity; case, spaces and underscores are ignored. A name with further words
(`theta_ref_deg`) means something else. `T` and `M` are torques if their unit is one.
"""

import re
import unicodedata
from typing import NamedTuple

from allocator.units import BAR, DEG, KPA, MM, MPA, PERCENT, PSI

_PRESSURE = {"bar": BAR, "kPa": KPA, "MPa": MPA, "psi": PSI, "Pa": 1.0, "mbar": 1e-3 * BAR, "hPa": 100.0}
_LBF, _KGF = 4.4482216152605, 9.80665  # [N]
_LENGTH = {"mm": MM, "m": 1.0, "cm": 1e-2, "in": 0.0254}

UNITS: dict[str, dict[str, float]] = {  # by quantity, the usual unit first; "" if a name needs none
    "contraction": {"%": PERCENT, "ratio": 1.0, "": 1.0},
    "length": _LENGTH,
    "shortening": _LENGTH,
    "pressure": _PRESSURE,
    "pressure1": _PRESSURE,
    "pressure2": _PRESSURE,
    "measured1": _PRESSURE,
    "measured2": _PRESSURE,
    "force": {"N": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": _LBF, "kgf": _KGF, "gf": 1e-3 * _KGF},
    "theta": {"deg": DEG, "rad": 1.0},
    "torque": {
        **{"Nm": 1.0, "Nmm": 1e-3, "Ncm": 1e-2, "kNm": 1e3, "mNm": 1e-3},
        **{"kgf m": _KGF, "kgf cm": 1e-2 * _KGF, "gf cm": 1e-5 * _KGF},
        **{"lbf in": 0.0254 * _LBF, "lbf ft": 0.3048 * _LBF, "ozf in": 0.0254 * _LBF / 16},
    },
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "": 1.0},
    "direction": {"": 1.0},
    "sweep": {"": 1.0},
    "slack": {"": 1.0},
    "rest_length": _LENGTH,
}

_NAMES = {
    "contraction": "contraction eps epsilon ε kontraktion kontraktionsgrad tauxdecontraction",
    "length": "length l musclelength länge laenge muskellänge longueur",
    "shortening": "shortening stroke verkürzung hub raccourcissement",
    "pressure": "pressure p musclepressure druck überdruck pression",
    "pressure1": "pressure1 p1 agonistpressure pressureagonist pagonist druck1 pression1",
    "pressure2": "pressure2 p2 antagonistpressure pressureantagonist pantagonist druck2 pression2",
    "measured1": "measured1 p1measured measuredp1 pressure1measured measuredpressure1",
    "measured2": "measured2 p2measured measuredp2 pressure2measured measuredpressure2",
    "force": "force f muscleforce pullingforce tensileforce load loadcell tension pull kraft zugkraft muskelkraft",
    "theta": "theta θ phi φ angle jointangle winkel gelenkwinkel",
    "torque": "torque drehmoment couple tau τ moment lastmoment loadtorque torqueload externaltorque weight last poids "
    "gewicht gewichtsmoment",
    "time": "time %time t zeit temps timestamp stamp zeitstempel uhrzeit datetime datumzeit datumuhrzeit xvalue xaxis "
    "elapsed elapsedtime relativetime rosbagtimestamp zeitpunkt horodatage clock clocktime timeofday",
    "direction": "direction richtung dir sens moving motion movement bewegung bewegungsrichtung drehrichtung branch",
    "sweep": "sweep",
    "slack": "slack schlaff",
    "rest_length": "restlength l0 initiallength nominallength ruhelänge",
}
_QUANTITIES = {name: quantity for quantity, names in _NAMES.items() for name in names.split()}

_UNIT_WORDS = {
    "%": "pct percent prozent pourcent",
    "ratio": "1",
    "deg": "° degree degrees grad degré degrés",
    "rad": "radian radians",
    "N": "newton newtons",
    "kgf": "kg kp",
    "gf": "g",
    "lbf": "lb lbs",
    "m": "metre meter",
    "in": "inch inches",
    "s": "sec secs second seconds sekunde sekunden",
    "ms": "msec millisecond milliseconds",
    "us": "µs μs usec microsecond microseconds",
    "ns": "nsec nanosecond nanoseconds",
    "min": "minute minutes minuten",
    "h": "hour hours stunde stunden",
    "Nm": "newtonmeter newtonmeters newtonmetre newtonmetres",
}
_SPELLED = {word: unit for unit, words in _UNIT_WORDS.items() for word in words.split()}
_SPELLED |= {unit.lower(): unit for units in UNITS.values() for unit in units if unit}
_FORCES = {"kgf": "kgf kg kp kgforce", "gf": "gf g", "lbf": "lbf lb lbs pound pounds", "ozf": "ozf oz"}
_ARMS = {"m": "m metre meter", "cm": "cm", "in": "in inch inches", "ft": "ft foot feet"}
_SPELLED |= {  # lbf in, in lbf, kgf·cm, oz-in
    words: f"{force} {arm}"
    for force, forces in _FORCES.items()
    for arm, arms in _ARMS.items()
    if f"{force} {arm}" in UNITS["torque"]
    for f in forces.split()
    for a in arms.split()
    for words in (f"{f} {a}", f"{a} {f}", f"{f}{a}", f"{a}{f}")
}
_WORDS_OF_A_UNIT = max(unit.count(" ") for unit in _SPELLED) + 1
_LETTERS = {"t": "torque", "m": "torque"}  # which mean this quantity if the unit fits
_TEMPERATURES = {"c", "°c", "degc", "celsius", "k", "kelvin", "f", "°f"}
_CLOCK = re.compile(r"\bh{1,2}:m{1,2}(:s{1,2})?([.,:](f+|s+|m?s|0+|x+))?")

_ABSOLUTE = {"abs", "absolute", "absolut", "absolue"}
_GAUGE = {"gauge", "gage", "rel", "relative", "relativ"}
_MARKED = {f"{unit.lower()}{mark}": (unit, mark == "a") for unit in _PRESSURE for mark in "ag"}  # bara, psig


class Meaning(NamedTuple):
    """Quantity and unit of a name; a `unit` outside `UNITS[quantity]` was not recognised."""

    quantity: str
    unit: str  # "" if the name gives none
    absolute: bool  # of a pressure


def meaning_of(name: str) -> Meaning | None:
    """Return the meaning of a column's name, or None if it names no known quantity."""
    words, absolute = _words(name)
    if not words:
        return None
    if quantity := _QUANTITIES.get("".join(words)):
        return Meaning(quantity, "", absolute)
    before, unit, marked = _split_unit(words)
    quantity, other = (known.get("".join(before)) for known in (_QUANTITIES, _LETTERS))
    if other is not None and unit in UNITS[other]:
        quantity = other
    if quantity == "shortening" and unit in ("%", "ratio"):
        quantity = "contraction"
    if quantity is None or UNITS[quantity].keys() == {""} or (before == ["t"] and unit in _TEMPERATURES):
        return None
    return Meaning(quantity, unit, absolute or marked)


def unit_of(text: str) -> tuple[str, bool]:
    """Return the unit in its usual spelling (or unchanged), and whether it is marked absolute: `bar(abs)`, `psia`."""
    words, absolute = _words(text)
    before, unit, marked = _split_unit(words) if words else ([], text, False)
    return (text if before else unit), absolute or marked


def is_unit(text: str) -> bool:
    """Return whether the text is a unit of any quantity, such as `bar`, `[deg]` or `N m`."""
    return bool(text.strip()) and unit_of(text)[0] in _ALL_UNITS


def unit_said(name: str) -> str:
    """Return the unit at the end of a name of any quantity, in its usual spelling; "" if there is none."""
    words, _ = _words(name)
    unit = _split_unit(words)[1] if words else ""
    return unit if unit in _ALL_UNITS else ""


def quantity_named(text: str) -> str | None:
    """Return the quantity of a word, None if it is unknown."""
    return _QUANTITIES.get("".join(_words(text)[0]))


def _split_unit(words: list[str]) -> tuple[list[str], str, bool]:
    """Return the words before the unit, the unit in its usual spelling, and whether it is marked as absolute."""
    for count in range(min(_WORDS_OF_A_UNIT, len(words)), 1, -1):
        named = len(words) > count or words[0] not in _LETTERS
        if named and (text := " ".join(words[-count:])) in _SPELLED:
            return _without_in(words[:-count]), _SPELLED[text], False
    last = words[-1]
    unit, marked = _MARKED.get(last, (_SPELLED.get(last, last), False))
    return _without_in(words[:-1]), unit, marked


def _without_in(words: list[str]) -> list[str]:
    """Return the words without the last one of `Druck in bar`."""
    return words[:-1] if words[-1:] == ["in"] else words


def _words(text: str) -> tuple[list[str], bool]:
    """Return the words of a name in lower case, without "absolute" and "gauge"; whether it was absolute."""
    text = unicodedata.normalize("NFKC", text).casefold()
    text = _CLOCK.sub("", text)
    text = re.sub(r"\b(k|m)?n\s*[·⋅∙•*×.\s-]\s*(c|m)?m\b", r"\1n\2m", text)  # N·m, N mm
    words = re.findall(r"[^\W_]+|[%°]", text)
    if len(words) > 1 and words[-1] in ("a", "g") and words[-2] in _SPELLED:  # bar(a), bar(g)
        words[-2:] = [words[-2] + words[-1]]
    return [word for word in words if word not in _ABSOLUTE | _GAUGE], any(word in _ABSOLUTE for word in words)


_ALL_UNITS = {unit for units in UNITS.values() for unit in units if unit} - {"ratio"}
