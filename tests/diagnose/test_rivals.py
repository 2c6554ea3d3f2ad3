"""Terms that are the same everywhere: which of two kinds it is, parameters tell that have followed either."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose import unlisted as module
from thermofit.diagnose.case import Case
from thermofit.diagnose.unlisted import likelier, or_rival, weighed


def term(kind: str, left: float, gain: float = 0.9, places: int = 1) -> Any:
    """A term, what held-out data it leaves, and its gain at the optimum."""
    return SimpleNamespace(
        basis=SimpleNamespace(kind=kind, grid=SimpleNamespace(places=places)), left=left, proof=SimpleNamespace(gain=gain)
    )


@dataclass(frozen=True)
class Told:
    """What is read of a term with the parameters that have followed it."""

    field: Any
    settled: bool = True
    parameters: Any = field(default_factory=lambda: SimpleNamespace(free=()))
    case: Any = None
    remark: str = ""


def told(kind: str, left: float, settled: bool = True, places: int = 1) -> Told:
    return Told(term(kind, left, places=places), settled)


SURFACE = {"theta": ("flux", "jaws")}
CAMERAS = {"theta": ("offset", "gradient", "clock")}


def asked(
    monkeypatch: pytest.MonkeyPatch,
    whole: Any,
    rivals: dict[str, float],
    ends: dict[str, Any],
    segments: Any = None,
    apart: Any = None,
    likely: dict[str, dict[str, float]] | None = None,
) -> tuple[Any, list[str]]:
    """What is told where rivals have these gains at the optimum and these ends, and of which kinds the ends were asked; `likely`: how
    likely other kinds are beside one."""
    made: list[str] = []
    missing = SimpleNamespace(of_surface=SURFACE, of_instruments=CAMERAS, records=())
    linearised = lambda *_: (np.zeros(3), np.zeros((3, 1)))  # noqa: E731
    here: Any = SimpleNamespace(case=SimpleNamespace(model=SimpleNamespace(missing=missing, segments=segments, linearised=linearised)))
    structure: Any = SimpleNamespace(blocks=SimpleNamespace(channel="dtheta"))

    def alike(here: Any, there: Any, structure: Any, kinds: Any) -> Any:
        ((kind,),) = kinds.values()
        assert kind not in ("gradient", whole.field.basis.kind)
        gain = rivals.get(kind) if there is not apart else rivals.get(f"{kind} apart")
        return None if gain is None else SimpleNamespace(term=term(kind, 0.0, gain))

    def weigh(known: Any, case: Any, structure: Any, term: Any, parameters: Any) -> Any:
        share = (likely or {}).get(term.basis.kind, {})
        if "fails" in share:
            raise NumericsError("no equilibrium")
        return SimpleNamespace(likelihood=share)

    def end(here: Any, structure: Any, begin: Any, alone: Any) -> Any:
        made.append(f"{begin.term.basis.kind} {begin.term.proof.gain}")
        return ends[begin.term.basis.kind]

    monkeypatch.setattr(module, "beside_term", lambda known, *_: known)
    monkeypatch.setattr(module, "weighed", weigh)
    monkeypatch.setattr(module, "everywhere_alike", alike)
    monkeypatch.setattr(module, "told", end)
    monkeypatch.setattr(module, "predicts_better", lambda _, one, other: one.left < other.left - 0.1)
    nothing: Any = None
    return or_rival(here, here if apart is None else apart, structure, whole, nothing), made


def test_a_rival_that_predicts_better_once_parameters_have_followed_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of what a camera adds the best of those at the optimum is asked; a lamp in the stead of an offset."""
    offset, flux, jaws = told("offset", 1.5), told("flux", 1.0), told("jaws", 0.9)
    found, made = asked(monkeypatch, offset, {"flux": 0.85, "jaws": 0.8}, {"flux": flux, "jaws": jaws})
    assert found is flux and made == ["flux 0.85"]
    found, _ = asked(monkeypatch, offset, {"clock": 0.85}, {"clock": told("clock", 1.45)})
    assert found is offset, "about as well is not better"
    found, _ = asked(monkeypatch, offset, {"flux": 0.85}, {"flux": None})
    assert found is offset


def test_a_camera_has_to_predict_better_than_a_heat(monkeypatch: pytest.MonkeyPatch) -> None:
    """About as well is not enough, as it is not at the optimum; nor is it for a camera in the stead of a heat."""
    offset, flux = told("offset", 1.0), told("flux", 1.05)
    assert asked(monkeypatch, offset, {"flux": 0.9}, {"flux": flux})[0] is flux
    assert asked(monkeypatch, offset, {"flux": 0.9}, {"flux": told("flux", 1.2)})[0] is offset
    assert asked(monkeypatch, flux, {"offset": 0.9}, {"offset": offset})[0] is flux


def test_no_rival_that_was_far_behind_or_has_not_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    offset = told("offset", 1.5)
    found, made = asked(monkeypatch, offset, {"flux": 0.7}, {"flux": told("flux", 1.0)})
    assert found is offset and made == []
    found, made = asked(monkeypatch, offset, {}, {})
    assert found is offset and made == []
    found, made = asked(monkeypatch, offset, {"flux": 0.85}, {"flux": told("flux", 1.0, settled=False)})
    assert found is offset and len(made) == 1


def test_beside_what_does_not_settle_a_rival_that_predicts_no_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    flux = told("flux", 1.0, settled=False)
    jaws, worse = told("jaws", 1.05), told("jaws", 1.2)
    assert asked(monkeypatch, flux, {"jaws": 0.9}, {"jaws": jaws})[0] is jaws
    assert asked(monkeypatch, flux, {"jaws": 0.9}, {"jaws": worse})[0] is flux
    assert asked(monkeypatch, told("flux", 1.0), {"jaws": 0.9}, {"jaws": jaws})[0].field.basis.kind == "flux"


def test_terms_with_places_and_those_of_coupons_have_none(monkeypatch: pytest.MonkeyPatch) -> None:
    for whole, segments in ((told("heat", 1.5, places=12), None), (told("offset", 1.5), ())):
        found, made = asked(monkeypatch, whole, {"flux": 0.9}, {"flux": told("flux", 1.0)}, segments)
        assert found is whole and made == []


def test_a_rival_at_protected_parameters_counts_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    flux = told("flux", 1.0)
    found, made = asked(monkeypatch, told("offset", 1.5), {"flux": 0.5, "flux apart": 0.95}, {"flux": flux}, apart=SimpleNamespace())
    assert found is flux and made == ["flux 0.95"]


def test_the_kind_that_is_likelier_than_not_beside_a_term_is_its_rival(monkeypatch: pytest.MonkeyPatch) -> None:
    """However far it was behind at the optimum, and no other one; beside a heat that settles none is asked else."""
    flux, jaws, clock = told("flux", 1.5), told("jaws", 0.9), told("clock", 1.0)
    rivals, ends = {"jaws": 0.88, "clock": 0.1}, {"jaws": jaws, "clock": clock}
    found, made = asked(monkeypatch, flux, rivals, ends, likely={"flux": {"clock": 0.8, "jaws": 0.1}})
    assert found is clock and made == ["clock 0.1"]
    found, _ = asked(monkeypatch, flux, rivals, ends, likely={"flux": {"clock": 0.8}, "clock": {"flux": 0.9}})
    assert found is clock, "it predicts better, though the term is likely beside it as well"
    found, made = asked(monkeypatch, flux, rivals, ends, likely={"flux": {"clock": 0.5, "jaws": 0.1}})
    assert found is flux and made == []


def test_one_that_does_without_the_term_is_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A film in the stead of a heat through the surface, both of which leave the noise: beside the film no such heat is likely."""
    flux, film = told("flux", 1.0), told("film", 1.05)
    monkeypatch.setitem(SURFACE, "theta", ("flux", "film", "jaws"))
    likely = {"flux": {"film": 0.99}}
    for beside, told_is in (({}, film), ({"flux": 0.4}, film), ({"flux": 0.6}, flux), ({"flux": 0.0, "jaws": 0.9}, film)):
        found, _ = asked(monkeypatch, flux, {"film": 0.9}, {"film": film}, likely=likely | {"film": beside})
        assert found is told_is, beside
    worse = told("film", 1.2)
    assert asked(monkeypatch, flux, {"film": 0.9}, {"film": worse}, likely=likely | {"film": {"flux": 0.0}})[0] is flux


def test_a_run_that_fails_is_said_and_tells_no_rival(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the term, and beside its rival, which then does not take its place."""
    flux, clock = told("flux", 1.0), told("clock", 1.0)
    words = "other kinds of histories were not weighed beside the {}: a run failed (no equilibrium)"
    found, made = asked(monkeypatch, replace(flux, remark="held"), {"clock": 0.9}, {"clock": clock}, likely={"flux": {"fails": 1.0}})
    assert found.field is flux.field and found.remark == "held; " + words.format("flux") and made == []
    found, _ = asked(monkeypatch, flux, {"clock": 0.9}, {"clock": clock}, likely={"flux": {"clock": 0.8}, "clock": {"fails": 1.0}})
    assert found.field is flux.field and found.remark == words.format("clock")


def test_other_kinds_are_weighed_where_the_parameters_beside_the_term_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """With its own case where errors were told anew; none are where they have not settled."""
    asked: list[Any] = []

    def linearised(p: Parameters, names: tuple[str, ...]) -> Any:
        asked.append((p["kappa"], names))
        return np.zeros(3), np.zeros((3, 1))

    model: Any = SimpleNamespace(linearised=linearised)
    optimum, own = (Case(model, Parameters.of({"kappa": k}, ("kappa",)), (), (), frozenset()) for k in (110.0, 111.0))
    monkeypatch.setattr(module, "histories", lambda case, *_: asked.append(case.parameters["kappa"]) or {"film": None})
    monkeypatch.setattr(module, "beside_term", lambda known, case, p, term: asked.append(p["kappa"]) or known)
    monkeypatch.setattr(module, "second_histories", lambda known, term, others: SimpleNamespace(likelihood=dict.fromkeys(others, 0.7)))
    here: Any = SimpleNamespace(case=optimum)
    found: Any = replace(told("flux", 1.0), case=own, parameters=Parameters.of({"kappa": 130.0}, ("kappa",)))
    nothing: Any = None
    assert likelier(here, nothing, found) == ("film", "") and asked == [(130.0, ("kappa",)), 130.0, 130.0]
    assert likelier(here, nothing, replace(found, settled=False)) == ("", "")
    assert weighed(nothing, own, nothing, found.field, found.parameters).likelihood == {"film": 0.7}
