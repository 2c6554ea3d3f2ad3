"""The words of coupon records as tables: what names of columns and lines of a header say, in English, German and French.

Names are compared in lower case, without accents, with `_` as a blank (`spoken`). A language or a laboratory is added by a word here.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping

_STRESS = r"stress|sigma|\u03c3|spannung|contrainte"
_STRAIN = (
    r"strain|epsilon|\u03b5|\beps|dehnung|stauchung|^(true |eng |nom )?e( true| eng| nom)?$|^e(psilon|ps)? ?(xx|yy)$|"
    r"umformgrad|hencky"
)
_LENGTHENING = r"^ext|exten|elong|^dl$|^delta ?l$|^u$|deform|verlangerung|clip"

WORDS: tuple[tuple[str, str], ...] = (
    ("rate", r"rate$|speed|velocity|geschwindigkeit|vitesse"),
    ("plastic_strain", r"plast\w* ?(strain|dehnung)|strain ?plast|deformation plast|^e(ps)? pl?$"),
    (
        "lateral_strain",
        r"(lateral|transvers|diametral)(?!.*(force|load|kraft|stress|speed))|querdehn|querkontr|breitenander|"
        r"\bwidth (strain|change)|(change of|delta) width|^e(psilon|ps)? ?(t|trans|lat|w)$",
    ),
    ("stress", _STRESS),
    ("temperature", r"temp(?!s)|pyrometer|thermocouple|pt100"),
    ("time", r"^t$|time|temps|zeit"),
    ("force", r"^f$|force|kraft|load(?!ing)|charge"),
    ("strain", _STRAIN),
    ("extension", _LENGTHENING),
    ("displacement", r"displ|deplac|travel|weg|traverse|crosshead|position|separation|stroke|^utr$|course"),
)
"""Meaning and words of a column; the first row that fits its unit counts."""

KINDS: Mapping[str, str] = {
    "true": r"true|\bwahre|\bvraie?|cauchy|\blog(arithm\w*)?\b|logarithm|hencky|natural strain|umformgrad",
    "nominal": r"\beng\b|\beng(?= ?str)|engineering|\bnom\b|\bnom(?= ?str)|nominal|\btech\b|technical|technisch|ingenieur|\bnenn|"
    r"convention|konvention|piola",
}
"""Words that tell true (Cauchy stress, logarithmic strain) from nominal (engineering) quantities."""

BY_QUANTITY: Mapping[str, tuple[str, ...]] = {
    "time": ("time",),
    "force": ("force",),
    "temperature": ("temperature",),
    "stress": ("stress",),
    "strain": ("plastic_strain", "lateral_strain", "strain"),
    "length": ("extension", "displacement"),
}
"""Meanings that a column with a unit of the quantity may have; the last one where the words say nothing."""

NOT_ABOUT = r"(?i).*(after|fracture|broken|final|minimum|bruch|rupture|apr.s).*"
"""Lines that speak of the specimen after the test, whatever else they say."""

ABOUT: tuple[tuple[str, str, str], ...] = (
    (
        "gauge_length",
        "mm",
        r"L_?0|(?i:((initial|original) )?gau?ge.?length.*|(initial|original) length.*|messl\u00e4nge.*|.*extensometer.*base.*)",
    ),
    ("diameter", "mm", r"[Dd]_?0?|(?i:((initial|original|gau?ge) )?diameter.*|durchmesser.*)"),
    ("thickness", "mm", r"a0|(?i:(specimen |initial |original |sheet )?thickness.*|(proben|blech)?dicke.*)"),
    ("width", "mm", r"b0|(?i:(specimen |initial |original )?width.*|(proben)?breite.*)"),
    ("area", "mm^2", r"A_?0?|S_?0|(?i:((initial|original) )?cross.?section.*|((initial|original) )?area.*|.*querschnitt.*)"),
    ("temperature", "K", r"T_?0?|(?i:(test(ing)?|specimen|initial|nominal)?[ _]?temperature|(pr\u00fcf|proben)?temperatur|temp)"),
    (
        "rate",
        "1/s",
        r"(?i:((nominal|engineering|initial|average|mean|test) )?(strain|deformation)[ _-]?rate|rate|dehn(ungs)?(rate|geschwindigkeit)|"
        r"(strain|eps|epsilon|e)[ _]?dot|vitesse de d.formation)",
    ),
)
"""What a line of the header says of specimen and test: key, fixed unit, name of the line as written."""

DATED = r"(?i).*(date|datum|start|begin|beginn|d.but|time|zeit|heure|created|acquisition).*"
"""Lines of a header that may say when the test began."""


def plain(name: str) -> str:
    """A name in lower case, without accents and with single blanks."""
    folded = unicodedata.normalize("NFKD", name)
    return re.sub(r"\s+", " ", "".join(c for c in folded if not unicodedata.combining(c))).strip().lower()


def spoken(name: str) -> str:
    """A plain name as words: `_`, brackets and stops are blanks, and so is the border inside `TrueStrain`."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])", " ", name)
    return re.sub(r"\s+", " ", re.sub(r"[_\-.,()\[\]{}/:]", " ", re.sub(r"^c_?\d+_", "", plain(parted)))).strip()


def kind_of(text: str) -> str:
    """ "true" or "nominal" where the words say one of them and not the other, else empty."""
    words = spoken(text)
    found = [kind for kind, pattern in KINDS.items() if re.search(pattern, words)]
    return found[0] if len(found) == 1 else ""


def meanings_of(name: str) -> list[str]:
    """Meanings that the words of a name allow, the likeliest first; true quantities have their own."""
    words = spoken(name)
    found = [meaning for meaning, pattern in WORDS if re.search(pattern, words)]
    true = kind_of(name) == "true"
    if name.strip() == "E":
        return []  # a modulus; e is a strain
    if name.strip() == "T":
        found.insert(0, "temperature")  # t is a time; T without a unit rather is none
    return [f"true_{meaning}" if true and meaning in ("stress", "strain") else meaning for meaning in found]
