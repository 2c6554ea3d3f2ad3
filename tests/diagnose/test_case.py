"""What is asked of a run when effects are scored: which of them are asked beside their neutral value."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import seen_field
from coupon_sets import TRUTH, pulled_record
from said_progress import said_progress

from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import TINY, Case, feels_rate, linearised, nowhere, scans
from thermofit.effects.catalogue import HEAT, KINEMATICS, LOAD, Effect, effect, effects
from thermofit.experiment.coupon_model import offsets
from thermofit.experiment.known_effects import effects_of_fields, effects_of_point
from thermofit.experiment.missing_coupon import CouponMissing
from thermofit.experiment.residuals import Span
from thermofit.observe.stations import INFRARED
from thermofit.point.driver import PointHistory, PointSettings, Programme, simulate

AT = Parameters.of({"theta_ref": 296.0}, ("E",))


def test_effects_that_feel_the_rate_of_flow() -> None:
    assert {e.name for e in effects() if feels_rate(e, AT)} == {"rate_power", "rate_logarithmic", "rate_by_temperature"}
    assert feels_rate(effect("rate_by_temperature"), AT.replace(theta_ref=293.15)), "also where its own reference lies"


def test_only_overstress_is_asked_beside_neutral() -> None:
    """Where the driver tells the two fields apart, and where it does not."""
    seen: list[dict[str, float]] = []

    def columns(parameters: Parameters, names: tuple[str, ...], *_: Any) -> tuple[np.ndarray, ...]:
        seen.append({n: parameters[n] for n in changed})
        return np.zeros(3), np.zeros((3, len(names))), np.zeros((3, 0))

    known = tuple(effect(name) for name in ("rate_power", "yield_plateau", "second_hardening"))
    changed = {e.amplitude.name: TINY * float(e.amplitude.probe or 0.0) for e in known}
    model = cast(Any, SimpleNamespace(linearised=lambda *given: columns(*given)[:2]))
    case = Case(model, AT, known, (Span("all", 0.0, 1.0),), frozenset(), scored=cast(Any, columns))
    linearised(case)
    linearised(replace(case, scored=None))
    assert seen == 2 * [{n: v if n.startswith("rate_") else 0.0 for n, v in changed.items()}]
    assert seen[0]["rate_power.K"] > 0.0
    both = (*known, effect("rate_logarithmic"))
    linearised(replace(case, known=both, parameters=AT.replace(**{"rate_logarithmic.C": 0.01}).with_free(("rate_logarithmic.C",))))
    assert seen[-1]["rate_power.K"] == 0.0, "an overstress that is on makes points flow; a second one may be more than the run bears"


def test_a_run_that_asks_all_effects_of_a_body_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes as long as several evaluations of a fit, which are shown as well. That of coupons is over at once."""
    said = said_progress(monkeypatch, "thermofit.diagnose.case")

    def columns(_: Any, names: tuple[str, ...], directions: Any = ()) -> tuple[np.ndarray, ...]:
        return np.zeros(3), np.zeros((3, len(names))), np.zeros((3, len(directions)))

    known = tuple(effect(name) for name in ("yield_plateau", "second_hardening"))
    model = cast(Any, SimpleNamespace(linearised=lambda *given: columns(*given)[:2]))
    case = Case(model, AT, known, (Span("all", 0.0, 1.0),), frozenset(), scored=cast(Any, columns))
    linearised(replace(case, scored=None))
    assert not said
    linearised(case)
    assert said == [("influence of the effects", "2 effects, 3 columns", None)]


def test_where_records_of_coupons_flow() -> None:
    """Every row of all records at which Lambda grows, each with its own rate and temperature."""
    tests = (pulled_record("slow", 1e-3, 293.0, 1, 1.0, 0.05), pulled_record("fast", 0.2, 393.0, 2, 1.0, 0.08))

    def run(parameters: Parameters, test: Any) -> PointHistory:
        return simulate(parameters, Programme.by_strain(test.time, test.strain, test.theta_start), PointSettings(model=1))

    at = Parameters.of({**TRUTH, "theta_air": 293.0, "theta_ref": 293.0})
    missing = CouponMissing(tests, offsets(tests), lambda parameters, _: parameters, run, ("stress",))
    accumulated, rate, theta = Case(cast(Any, SimpleNamespace(missing=missing)), at, (), (), frozenset()).flow()
    histories = [run(at, test) for test in tests]
    assert accumulated.max() == max(h.accumulated.max() for h in histories) and accumulated.min() > 0.0
    fast = theta > 350.0
    assert np.median(rate[fast]) == pytest.approx(0.2, rel=0.1) and np.median(rate[~fast]) == pytest.approx(1e-3, rel=0.1)
    assert len(accumulated) == sum(int((np.diff(h.accumulated) > 0.0).sum()) for h in histories)


def test_a_body_flows_up_to_its_largest_strain() -> None:
    accumulated, rate, theta = Case(cast(Any, SimpleNamespace(missing=None)), AT, (), (), frozenset(), largest_strain=0.37).flow()
    assert accumulated[0] == 0.0 and accumulated[-1] == 0.37 and len(accumulated) == len(rate) == len(theta)
    assert np.all(rate > 0.0) and np.all(abs(theta - AT["theta_ref"]) < 50.0)


def test_scans_are_shares_of_the_largest_strain_of_the_test() -> None:
    case = Case(cast(Any, None), AT, (), (Span("all", 0.0, 1.0),), frozenset(), largest_strain=0.4)
    tried = scans(effect("latent_heat"), case)[1:]
    centres, widths = param("latent_heat.centre").scan, param("latent_heat.width").scan
    expected = {(0.4 * c, 0.4 * w) for c in centres for w in widths}
    assert {(s["latent_heat.centre"], s["latent_heat.width"]) for s in tried} == expected and len(tried) == 20


def test_places_are_shares_of_the_observed_height() -> None:
    """Of its own experiment where a Param is of one."""
    case = seen_field.case_of(1)
    tried = scans(effect("local_source"), case)[1:]
    places, widths, starts = (sorted({s[f"local_source.{n}"] for s in tried}) for n in ("place", "width", "start"))
    assert places == pytest.approx([-20.0 + 40.0 * share for share in param("local_source.place").scan])
    assert widths == pytest.approx([40.0 * share for share in param("local_source.width").scan])
    assert starts == pytest.approx([120.0 * share for share in param("local_source.start").scan])
    assert len(tried) == len(places) * len(widths) * len(starts)
    rows = case.rows
    above = replace(rows, phase=np.where(rows.xy[:, 1] > 0.0, 1, 0))
    two = (Span("a", 0.0, 120.0, "low"), Span("b", 0.0, 120.0, "high"))
    of_one = scans(effect("local_source@high"), replace(case, placed=above, spans=two))[1:]
    lowest = float(rows.xy[rows.xy[:, 1] > 0.0, 1].min())
    assert min(s["local_source.place@high"] for s in of_one) == pytest.approx(lowest + 0.05 * (20.0 - lowest))


@pytest.mark.parametrize(("width", "told"), [(39.0, False), (41.0, True)])
def test_a_source_as_wide_as_what_is_observed_has_no_place(width: float, told: bool) -> None:
    """40 mm are observed."""
    case = seen_field.case_of(1)
    case = replace(case, parameters=case.parameters.replace(**{"local_source.power": 1.0, "local_source.width": width}))
    said = nowhere(case, ("ir_drift", "local_source"))
    assert len(said) == told and all("local_source.width is 41 mm, more than the 40 mm" in words for words in said)


def test_a_param_that_follows_is_fitted_but_one_value_of_it_is_tried() -> None:
    assert [p.name.partition(".")[2] for p in effect("latent_heat").exponents] == ["centre", "width", "rounding"]
    assert [p.name.partition(".")[2] for p in effect("lamp").exponents] == ["start", "onset"]
    assert effect("bending").exponents == () and param("bending.contraction").scan, "kept at its one value"


@pytest.mark.parametrize(
    ("known", "slots"),
    [
        (effects_of_fields(infrared=True), ()),
        (effects_of_fields(infrared=False), (*HEAT, *INFRARED)),
        (effects_of_point(sensor=True), (*HEAT, *LOAD, *KINEMATICS, "emission", "reflection", "optics", "camera")),
        (effects_of_point(sensor=False), (*HEAT, *LOAD, *KINEMATICS, *INFRARED, "camera")),
    ],
)
def test_what_a_driver_does_not_have_is_not_asked(known: tuple[Effect, ...], slots: tuple[str, ...]) -> None:
    """Of the base law a coupon lacks films and what needs a field; one of several experiments is asked as <effect>@<experiment>."""
    point = "bending" not in {e.name for e in known}
    case = Case(cast(Any, None), AT, known, (Span("all", 0.0, 1.0),), frozenset())
    spans = {"softening_power", "rate_by_temperature"}
    without = {"hill_anisotropy", "air_convection", "clamp_conductance"} if point else {*spans, "modulus_by_temperature"}
    elsewhere = {"heating_profile"}  # a row of sections alone has it
    if not point and "ir_drift" not in {e.name for e in known}:
        elsewhere |= {"stored_energy"}  # what it does is heat
    has = {"air_drift", "capacity_by_temperature"} if point and "ir_drift" in {e.name for e in known} else set()
    assert set(case.not_asked()) == {e.name for e in effects(slots)} - has | without | elsewhere
    assert set(case.not_asked()).isdisjoint(e.name for e in known)
    own = replace(case, known=tuple(effect(f"{e.name}@second") if e.name == "ir_drift" else e for e in known))
    assert own.not_asked() == case.not_asked()
