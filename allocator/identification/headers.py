"""The name of a column says what it holds: a quantity and its unit, in the words of several languages.

`eps [%]`, `Pressure (kPa)`, `Kraft in N`, `P1_bar` and `p/bar` are all read: the last word is the unit, in brackets or
not, and the words before it are the quantity; case, spaces and underscores do not count. A name that has further words
(`theta_ref_deg`) means something else.
"""

import re
import unicodedata
from typing import NamedTuple

from allocator.units import BAR, DEG, KPA, MM, MPA, PERCENT, PSI

_PRESSURE = {"bar": BAR, "kPa": KPA, "MPa": MPA, "psi": PSI, "Pa": 1.0, "mbar": 1e-3 * BAR, "hPa": 100.0}
_LENGTH = {"mm": MM, "m": 1.0, "cm": 1e-2, "in": 0.0254}

UNITS: dict[str, dict[str, float]] = {  # by quantity, the usual unit first; "" where a name needs none
    "contraction": {"%": PERCENT, "ratio": 1.0, "": 1.0},
    "length": _LENGTH,
    "shortening": _LENGTH,
    "pressure": _PRESSURE,
    "pressure1": _PRESSURE,
    "pressure2": _PRESSURE,
    "force": {"N": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": 4.4482216152605, "kgf": 9.80665, "gf": 9.80665e-3},
    "theta": {"deg": DEG, "rad": 1.0},
    "torque": {"Nm": 1.0, "Nmm": 1e-3, "Ncm": 1e-2},
    "time": {"s": 1.0, "ms": 1e-3, "": 1.0},
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
    "force": "force f muscleforce load tension pull kraft zugkraft",
    "theta": "theta θ phi φ angle jointangle winkel gelenkwinkel",
    "torque": "torque drehmoment couple",
    "time": "time t zeit temps",
    "direction": "direction richtung",
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
    "s": "sec second seconds",
}
_SPELLED = {word: unit for unit, words in _UNIT_WORDS.items() for word in words.split()}
_SPELLED |= {unit.lower(): unit for units in UNITS.values() for unit in units if unit}

_ABSOLUTE = {"abs", "absolute", "absolut", "absolue"}
_GAUGE = {"gauge", "gage", "rel", "relative", "relativ"}
_MARKED = {f"{unit.lower()}{mark}": (unit, mark == "a") for unit in _PRESSURE for mark in "ag"}  # bara, psig


class Meaning(NamedTuple):
    """A meaning is what a name says; a `unit` that is not in `UNITS[quantity]` was not understood."""

    quantity: str
    unit: str  # "" if the name gives none
    absolute: bool  # said of a pressure


def meaning_of(name: str) -> Meaning | None:
    """Return the meaning of a column's name, or None if it is no quantity that is known here."""
    words, absolute = _words(name)
    if not words:
        return None
    if quantity := _QUANTITIES.get("".join(words)):
        return Meaning(quantity, "", absolute)
    *before, last = words
    if before and before[-1] == "in":  # Druck in bar
        before.pop()
    quantity = _QUANTITIES.get("".join(before))
    unit, marked = _MARKED.get(last, (_SPELLED.get(last, last), False))
    return None if quantity is None else Meaning(quantity, unit, absolute or marked)


def unit_of(text: str) -> tuple[str, bool]:
    """Return the unit in its usual spelling (as it is if not known), and whether it says absolute: `bar(abs)`,
    `psia`.
    """
    words, absolute = _words(text)
    unit, marked = _MARKED.get("".join(words), (_SPELLED.get("".join(words), text), False))
    return unit, absolute or marked


def quantity_named(text: str) -> str | None:
    """Return the quantity that a word stands for, None if it is not known."""
    return _QUANTITIES.get("".join(_words(text)[0]))


def _words(text: str) -> tuple[list[str], bool]:
    """Return the words of a name in lower case, without "absolute" and "gauge"; whether it was absolute."""
    text = unicodedata.normalize("NFKC", text).casefold()
    text = re.sub(r"\bn\s*[·⋅*.\s-]\s*(c|m)?m\b", r"n\1m", text)  # N·m, N mm
    words = re.findall(r"[^\W_]+|[%°]", text)
    if len(words) > 1 and words[-1] in ("a", "g") and words[-2] in _SPELLED:  # bar(a), bar(g)
        words[-2:] = [words[-2] + words[-1]]
    return [word for word in words if word not in _ABSOLUTE | _GAUGE], any(word in _ABSOLUTE for word in words)


__all__ = ["UNITS", "Meaning", "meaning_of", "quantity_named", "unit_of"]
