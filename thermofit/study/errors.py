"""One sentence for what is wrong in a study file: key, what was found, what was expected, near miss."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pydantic_core import ErrorDetails, PydanticCustomError

TAG = "~"
"""First letter of the names of union members, which are no part of the key that the user wrote."""

UNKNOWN_KEY = "thermofit_unknown_key"
CONTENT = "thermofit_content"

_WANTED: Mapping[str, str] = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "string_type": "a text",
    "bool_type": "true or false",
    "tuple_type": "a list",
    "dict_type": "a section of keys",
    "model_type": "a section of keys",
    "model_attributes_type": "a section of keys",
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "less than {lt:g}",
    "less_than_equal": "at most {le:g}",
    "literal_error": "{expected}",
    "enum": "{expected}",
    "string_pattern_mismatch": "a text of the form {pattern}",
    "too_short": "at least {min_length} entries",
    "too_long": "at most {max_length} entries",
}
"""What was expected, by pydantic's type of the error; the names in braces are the error's context."""

_ALTERNATIVES: Mapping[str, str] = {
    TAG + "section": "a number or a section {start: ..., bounds: [.., ..], scale: ...}",
    TAG + "components": "a positive number, sigma, balanced, value, max or {x: ..., y: ...}",
    TAG + "size": "coarse, full, sheet, {n_x: .., n_y: .., n_z: ..} or {sheet: {n_x: .., n_y: ..}}",
    TAG + "times": "a list of times in s, or the word of the commented study",
    TAG + "interval": "auto, all or [t0, t1] in s",
    TAG + "published": "a number, [low, high] or {value: ..., sigma: ..., source: ...}",
    TAG + "column": "the name of a column or {column: ..., unit: ...}",
    TAG + "strain": "the name of a column or {column: ...}, {true_strain: ...} or {extension: ..., gauge_length: ...}",
    TAG + "stress": "the name of a column or {column: ..., unit: ...}, {true_stress: ...} or {force: ..., area: ...}",
    TAG + "lateral": "the name of a column or {column: ..., unit: ...} or {extension: ..., width: ...}",
    TAG + "temperature": "the name of a column or {column: ..., unit: ..., file: ..., time: ..., offset_s: auto}",
}
"""What was expected where a key may be a word or a number too, by union member."""


def near_miss(word: str, known: Iterable[str]) -> str:
    """The tail of a sentence about an unknown `word`: the nearest known word, else the list of all of them."""
    names = sorted(known)
    by_lower = {name.lower(): name for name in names}
    close = difflib.get_close_matches(word, names, n=1) or [by_lower[hit] for hit in difflib.get_close_matches(word.lower(), by_lower, n=1)]
    return f"; did you mean '{close[0]}'?" if close else f"; known are {', '.join(names)}"


def unknown_key(key: str, known: Iterable[str]) -> PydanticCustomError:
    """Error of a section that holds a key which it does not know."""
    return PydanticCustomError(UNKNOWN_KEY, "{key} is not known", {"key": key, "tail": near_miss(key, known)})


def content_error(text: str, key: str = "") -> PydanticCustomError:
    """Error of a value that has the right type and cannot be meant; `text` follows the words "key '...'".

    `key` is appended to the place where pydantic noticed it (a validator of a section knows the guilty key better).
    """
    return PydanticCustomError(CONTENT, "{text}", {"text": text, "key": key})


def dotted(location: Sequence[int | str]) -> str:
    """Dotted key of a pydantic location: union members and the mark of a dictionary's key are left out."""
    return ".".join(str(part) for part in location if part != "[key]" and not str(part).startswith(TAG))


def found(value: Any) -> str:
    """Short text of what was found."""
    text = "empty" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def sentence(error: ErrorDetails) -> tuple[str, str]:
    """The dotted key that an error of pydantic is about, and the sentence (without the name of the file), on one line whatever the study
    holds."""
    key, text = _sentence(error)
    return key, "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def _sentence(error: ErrorDetails) -> tuple[str, str]:
    context: dict[str, Any] = dict(error.get("ctx", {}))
    location, kind = error["loc"], error["type"]
    if kind == UNKNOWN_KEY:
        key = dotted((*location, context["key"]))
        return key, f"key '{key}' is not known{context['tail']}"
    if kind == CONTENT:
        key = dotted((*location, context["key"]) if context["key"] else location)
        return key, f"key '{key}' {context['text']}" if key else context["text"]
    key = dotted(location)
    if kind == "missing":
        if isinstance(location[-1], int):
            key = dotted(location[:-1])
            return key, f"key '{key}' ends before entry {location[-1] + 1}; expected more numbers, compare `thermofit new`"
        return key, f"key '{key}' is missing: add it"
    wanted = _WANTED[kind].format(**context) if kind in _WANTED else error["msg"].lower()
    if kind in ("model_type", "model_attributes_type", "tuple_type") and location:
        wanted = _ALTERNATIVES.get(str(location[-1]), wanted)
    return key, f"key '{key}' is {found(error['input'])}; expected {wanted}" if key else f"the study must be {wanted}"
