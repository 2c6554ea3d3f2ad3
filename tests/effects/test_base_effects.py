"""Effects that the base law holds: what a study holds fixed is dormant, and the mechanism is off at its neutral value."""

from __future__ import annotations

import pytest

from thermofit.core.errors import StudyError
from thermofit.core.parameters import NAMES, Parameters
from thermofit.effects.base import BASE, base_effect, held
from thermofit.effects.catalogue import effects


def test_every_effect_of_the_base_law_names_its_params_with_a_probe_in_bounds() -> None:
    assert len({e.name for e in BASE} | {e.name for e in effects()}) == len(BASE) + len(effects()), "no name is given twice"
    for e in BASE:
        assert set(e.names) <= set(NAMES) and e.formula and e.source
        for p in e.params:
            assert p.probe is not None and p.probe != p.neutral and p.lower <= p.probe <= p.upper


def test_what_a_study_frees_is_not_dormant() -> None:
    assert [e.name for e in held(())] == [e.name for e in BASE]
    kept = held(("alpha_exp", "G", "alpha_clamp", "E"))
    assert [e.name for e in kept] == ["linear_hardening", "hill_anisotropy", "air_convection"]
    assert kept[1].names == ("L",) and kept[1].amplitude.name == "L"


def test_neutral_switches_off() -> None:
    parameters = Parameters.of({"alpha_air": 12.0})
    assert not base_effect("air_convection").is_off(parameters)
    assert all(base_effect(name).is_off(parameters) for name in ("linear_hardening", "thermal_expansion", "clamp_conductance"))
    assert base_effect("clamp_conductance").reciprocal and not base_effect("air_convection").reciprocal


def test_unknown_name_is_refused_in_words() -> None:
    with pytest.raises(StudyError, match="is not one of the base law; those are linear_hardening"):
        base_effect("backlash")
