"""Effects that the base law holds take part in the catalogue: named Params with a probe, off at neutral, known by name."""

from __future__ import annotations

import pytest

from thermofit.core.errors import StudyError
from thermofit.core.parameters import NAMES, Parameters
from thermofit.effects.base import BASE as BASE_EFFECTS
from thermofit.effects.catalogue import BASE, Effect, effect, effects


def test_they_are_in_the_catalogue_under_names_of_their_own() -> None:
    names = [e.name for e in effects(BASE)]
    assert names == ["air_convection", "clamp_conductance", "hill_anisotropy", "linear_hardening", "thermal_expansion"]
    assert len(BASE_EFFECTS) == len(names), "no effect file takes the name of one"


@pytest.mark.parametrize("e", effects(BASE), ids=lambda e: e.name)
def test_params_are_those_of_the_base_law_with_a_probe_in_bounds(e: Effect) -> None:
    one = e
    assert set(one.names) <= set(NAMES) and one.formula and one.source
    for p in one.params:
        assert p.probe is not None and p.probe != p.neutral and p.lower <= p.probe <= p.upper
    assert Parameters.of({})[one.amplitude.name] == one.amplitude.neutral, "off in a study that says nothing of it"


def test_a_contact_is_told_to_be_linear_in_its_resistance() -> None:
    assert [e.name for e in effects() if e.reciprocal] == ["clamp_conductance"]


def test_no_function_acts_in_their_place() -> None:
    with pytest.raises(StudyError, match="act in the kernels"):
        effect("thermal_expansion").act(1.0)
