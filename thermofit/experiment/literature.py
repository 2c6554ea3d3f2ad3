"""What was identified beside what others published: section `literature` of the study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from thermofit.core.parameters import AT, bare_name, param
from thermofit.records.artefact import ParameterResult
from thermofit.study.literature import PRESSURE, published
from thermofit.study.study import Study

Row = dict[str, Any]


def literature_rows(study: Study, results: Mapping[str, ParameterResult]) -> list[Row]:
    """One row for every published value: what was found, with its standard error, and whether it lies in the published range.

    A parameter of several experiments has a row for each. c_p is c0 + 9 K alpha_exp^2 theta_ref (errata 6).
    """
    rows = []
    for name, given in study.literature.items():
        value = published(given)
        low, high = value.limits
        for found_name in _found(name, results):
            found = _pressure(results) if name == PRESSURE else results[found_name]
            where = _where(found.value, found.sigma, (low, high))
            row = {"parameter": found_name, "found": "" if found.free else "prescribed", "source": value.source, "compared": where}
            unit = param("c0").unit if name == PRESSURE else found.unit
            rows.append({**row, "unit": unit, "value": found.value, "sigma": found.sigma, "low": low, "high": high})
    return rows


def literature_remarks(rows: list[Row]) -> list[str]:
    """One remark for each identified parameter that lies outside what others found."""
    return [f"literature: {r['parameter']} = {r['value']:.4g} {r['unit']} is {r['compared']}" for r in rows if r["compared"] != "within"]


def _found(name: str, results: Mapping[str, ParameterResult]) -> list[str]:
    """The parameters that a published one is compared with: those of every experiment where there are any."""
    own = [other for other in results if bare_name(other) == name and AT in other]
    return own or [name]


def _pressure(results: Mapping[str, ParameterResult]) -> ParameterResult:
    v = {name: results[name].value for name in ("E", "nu", "c0", "alpha_exp", "theta_ref")}
    more = 9.0 * v["E"] / (3.0 * (1.0 - 2.0 * v["nu"])) * v["alpha_exp"] ** 2 * v["theta_ref"]
    c0 = results["c0"]
    return ParameterResult(c0.value + more, c0.sigma, c0.unit, c0.free, c0.at_bound, c0.start, c0.lower, c0.upper)


def _where(value: float, sigma: float | None, limits: tuple[float, float]) -> str:
    """In words how a value lies to a range: within, or how far off in its standard errors and per cent."""
    low, high = limits
    if low <= value <= high:
        return "within"
    edge, side = (low, "below") if value < low else (high, "above")
    far = f"{side} {low:g} to {high:g}" if low < high else f"{side} {low:g}"
    part = f" by {100.0 * abs(value - edge) / abs(edge):.2g} %" if edge else ""
    return far + part + (f", {abs(value - edge) / sigma:.2g} standard errors" if sigma else "")
