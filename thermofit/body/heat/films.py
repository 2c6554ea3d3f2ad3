"""Which film acts on which facet set of a body, by the name of the set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from thermofit.body.body import Body
from thermofit.body.heat.conduction import HeatConditions, heat_conditions
from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters


def conditions_of(body: Body, parameters: Parameters, films: Mapping[str, tuple[float, float]]) -> HeatConditions:
    """HeatConditions of every facet set of the body.

    The sets "air" and "clamp", or parts of them ("clamp_lower"), take the parameters of that film; any set may have its own
    (coefficient W/(m^2 K), medium temperature K) in `films`. StudyError for a set with neither, for a film without its set, and for a
    negative coefficient.
    """
    if unknown := sorted(set(films) - set(body.films)):
        raise StudyError(f"films: '{unknown[0]}' is no facet set of the mesh; it has {', '.join(sorted(body.films))}")
    named = heat_conditions(parameters)
    found: dict[str, tuple[float, float]] = {}
    for name in body.films:
        kind = name.partition("_")[0]
        if name not in films and kind not in named.films:
            raise StudyError(f"facet set '{name}': no film is given for it; name it air..., clamp... or give its coefficient and medium")
        found[name] = films[name] if name in films else named.films[kind]
        if found[name][0] < 0.0:
            raise StudyError(f"film on '{name}': coefficient {found[name][0]:g} W/(m^2 K) found; it must not be negative")
    if "clamp" not in found and not any(alpha > 0.0 for alpha, _ in found.values()):
        raise StudyError(
            "films: all coefficients are zero and no facet set is named 'clamp', whose medium would give the initial temperature"
        )
    return replace(named, films=found)
