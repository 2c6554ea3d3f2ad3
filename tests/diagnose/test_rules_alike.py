"""The rules of unlisted terms that are the same everywhere: in whose stead they are told, which is told next, and what is known beside."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose import unlisted as module
from thermofit.diagnose.case import Case
from thermofit.diagnose.held_out import Proof
from thermofit.diagnose.unlisted import GONE, UNSETTLED, Sought, Unlisted, of_instrument, over_time, through_surface, told, unlisted
from thermofit.experiment.missing import KINDS

GOOD = Proof(2.0, 1.0, {}, 0.5, 0.01, 5)
HERE: Any = SimpleNamespace(case=SimpleNamespace(model=SimpleNamespace(missing=SimpleNamespace(of_surface={}, of_instruments={}))))
APART: Any = SimpleNamespace()


@dataclass(frozen=True)
class Term:
    """What is read of a term: its kind, how well it predicts (of two, better by more than one is sure), places and rows."""

    kind: str
    well: float
    places: int = 1
    proof: Proof = GOOD

    @property
    def basis(self) -> Any:
        return SimpleNamespace(kind=self.kind, grid=SimpleNamespace(places=self.places), rows=np.arange(10))


def chosen(monkeypatch: pytest.MonkeyPatch, which: Any, there: Any, own: Term | None, term: Term | None) -> Any:
    """What a choice between a term and one that is the same everywhere takes."""
    alike = None if own is None else Sought(cast(Any, own), there)
    monkeypatch.setattr(module, "everywhere_alike", lambda *_: alike)
    monkeypatch.setattr(module, "predicts_better", lambda _, one, other: one.well > other.well + 1.0)
    found = which(HERE, there, cast(Any, None), term)
    return None if found is None else found.term


@pytest.mark.parametrize(
    ("which", "apart", "own", "term", "taken"),
    [
        (through_surface, False, Term("jaws", 5.0), Term("heat", 5.5, 9), True),  # no worse is enough: it has no place
        (through_surface, False, Term("jaws", 5.0), Term("heat", 6.5, 9), False),
        (through_surface, False, Term("jaws", 5.0), None, True),
        (through_surface, True, Term("jaws", 5.0), Term("heat", 4.5, 9), False),  # beside a broad source any smooth term does well
        (through_surface, True, Term("jaws", 5.0), Term("heat", 3.5, 9), True),
        (through_surface, False, None, Term("heat", 3.5, 9), False),
        (of_instrument, False, Term("offset", 5.0), Term("heat", 4.5, 9), False),  # a camera has to predict better than a source
        (of_instrument, False, Term("offset", 5.0), Term("heat", 3.5, 9), True),
        (of_instrument, False, Term("offset", 5.0), None, True),
        (of_instrument, False, Term("gradient", 5.0), None, False),  # temperatures that are not even at first look like one
        (of_instrument, False, Term("gradient", 5.0), Term("heat", 3.5, 9), True),
        (of_instrument, False, Term("strain", 5.0), Term("displacement", 5.5, 9), True),  # a map of the mode is no cause
        (of_instrument, False, Term("strain", 5.0), Term("displacement", 6.5, 9), False),
        (of_instrument, False, None, None, False),
    ],
)
def test_in_whose_stead_it_is_told(
    monkeypatch: pytest.MonkeyPatch, which: Any, apart: bool, own: Term | None, term: Term | None, taken: bool
) -> None:
    assert chosen(monkeypatch, which, APART if apart else HERE, own, term) is (own if taken else None)


@pytest.mark.parametrize(
    ("holds", "expected"), [({"flux", "heat"}, "flux"), ({"heat"}, "heat"), (set(), None)], ids=["first", "next", "none"]
)
def test_where_one_does_not_hold_the_next_best_is_told(monkeypatch: pytest.MonkeyPatch, holds: set[str], expected: str | None) -> None:
    """Terms of the surface are sought at the optimum and at protected parameters, those of cameras at the optimum alone."""
    here: Any = SimpleNamespace(
        ranking=SimpleNamespace(scores=()), case=SimpleNamespace(parameters=None, model=SimpleNamespace(segments=None))
    )
    structure: Any = SimpleNamespace(blocks=SimpleNamespace(channel="dtheta"))
    asked = []

    def surface(_: Any, there: Any, __: Any, term: Term) -> Sought:
        asked.append(("surface", there is here, term.kind))
        return Sought(cast(Any, Term("jaws" if there is here else "flux", 1.0)), there)

    def camera(_: Any, there: Any, __: Any, term: Term) -> None:
        asked.append(("camera", there is here, term.kind))

    monkeypatch.setattr(module, "best_listed", lambda *_: ("", 0.0))
    monkeypatch.setattr(module, "undriven", lambda *_: (APART, ""))
    monkeypatch.setattr(module, "sought", lambda *_: (Term("heat", 1.0, 9), here))
    monkeypatch.setattr(module, "through_surface", surface)
    monkeypatch.setattr(module, "of_instrument", camera)
    monkeypatch.setattr(module, "kind_of", lambda *_: "heat")
    monkeypatch.setattr(
        module, "told", lambda _, __, begin, alone: replace(alone, remark=begin.term.kind) if begin.term.kind in holds else None
    )
    found = unlisted(here, [structure], ())
    assert asked == [("surface", True, "heat"), ("surface", False, "jaws"), ("camera", True, "flux")]
    assert (None if found is None else found.remark) == expected


@pytest.mark.parametrize(
    ("first", "then", "settled"),
    [
        ("", None, True),  # no errors are told anew
        (UNSETTLED, None, False),
        (UNSETTLED, "", True),  # it has settled beside the errors that were told anew
        ("", UNSETTLED, False),
    ],
)
def test_whether_parameters_have_settled(monkeypatch: pytest.MonkeyPatch, first: str, then: str | None, settled: bool) -> None:
    begun, once, twice = Term("jaws", 1.0), Term("jaws", 2.0), Term("jaws", 3.0)
    found = tell(monkeypatch, begun, (once, first), (once, "") if then is None else (twice, then))
    assert found is not None and found.settled is settled and cast(Any, found.field) is (once if then is None else twice)
    assert found.remark == (UNSETTLED if UNSETTLED in (first, then) else "")


def test_a_term_that_goes_once_parameters_have_followed_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that has places stays as it was at the optimum."""
    jaws, heat = Term("jaws", 1.0), Term("heat", 1.0, 9)
    assert tell(monkeypatch, jaws, (jaws, GONE), (jaws, "")) is None
    once = Term("jaws", 2.0)
    assert tell(monkeypatch, jaws, (once, ""), (once, GONE)) is None, "nor where it goes beside errors that are told anew"
    kept = tell(monkeypatch, heat, (heat, GONE), (heat, ""))
    assert kept is not None and cast(Any, kept.field) is heat and kept.remark == GONE


def tell(monkeypatch: pytest.MonkeyPatch, term: Term, once: tuple[Term, str], twice: tuple[Term, str]) -> Unlisted | None:
    """What is told of a term whose parameters settle `once`, and again beside errors that are told anew: the term then, and words."""
    case: Any = SimpleNamespace(model=SimpleNamespace(segments=None), parameters=None)
    here: Any = SimpleNamespace(case=case, rows=SimpleNamespace(time=np.arange(10.0)))
    alone = Unlisted("dtheta", cast(Any, None), ("", 0.0), None, None, (), (), cast(Any, None))

    @dataclass(frozen=True)
    class Place:
        when: tuple[float, float] = (0.0, 9.0)
        size: float = 1.0
        doubt: float = 0.1

    monkeypatch.setattr(module, "settled", lambda *_: (once[0], None, once[1]))
    monkeypatch.setattr(module, "told_beside", lambda *_: (case, twice[0], None, twice[1]))
    monkeypatch.setattr(module, "place_of", lambda *_: Place())
    monkeypatch.setattr(module, "volumes", lambda *_: None)
    monkeypatch.setattr(module, "hints_of", lambda *_: ())
    return told(here, cast(Any, None), Sought(cast(Any, term), here), alone)


@dataclass(frozen=True)
class Stepping:
    """What `settled` reads of a term beside one parameter: the step to where it is told, its standard error, and where the parameter is."""

    step: np.ndarray
    uncertainty: np.ndarray
    basis: Any
    bare: float
    proof: Proof = GOOD
    before: Any = None
    after: Any = None
    q: np.ndarray = field(default_factory=lambda: np.ones(1))
    posterior: np.ndarray = field(default_factory=lambda: np.ones((1, 1)))
    together: np.ndarray = field(default_factory=lambda: np.ones((1, 1)))


def stepping(
    monkeypatch: pytest.MonkeyPatch, *overshoots: float, least: float = 130.0, most: float = np.inf, begin: float = 110.0
) -> tuple[Any, float, str, list[float]]:
    """The term, kappa and the words with which `settled` ends, and every kappa that was tried, where every step is `overshoots` times the
    way to kappa = 130 with a standard error of 1: of several each step the next one, and the last from there on. The sum of squares is
    least at `least`; with more than `most` no run succeeds."""
    tried: list[float] = []
    hat: Any = SimpleNamespace(kind="jaws", grid=SimpleNamespace(places=1, size=1, spread=0.0), chosen=np.zeros(1), alone=None)

    def term(_: Any, kappa: float, __: Any = None) -> Any:
        times = overshoots[min(len(tried), len(overshoots) - 1)]
        return Stepping(np.array([times * (130.0 - kappa)]), np.ones(1), hat, kappa)

    def linearised(p: Parameters, _: Any) -> tuple[float, None]:
        tried.append(p["kappa"])
        if p["kappa"] > most:
            raise NumericsError(f"no equilibrium at {p['kappa']:g}")
        return p["kappa"], None

    model: Any = SimpleNamespace(linearised=linearised, segments=None, missing=None)
    case = Case(model, Parameters.of({"kappa": begin}, ("kappa",)), (), (), frozenset())
    here: Any = SimpleNamespace(case=case, rows=None, split=SimpleNamespace(held_out=()))
    monkeypatch.setattr(module, "LinearModel", lambda kappa, _: kappa)
    monkeypatch.setattr(module, "basis", lambda *_: hat)
    monkeypatch.setattr(module, "over_time", lambda known, *_: term(None, known))
    monkeypatch.setattr(module, "best_of_its_form", lambda _, kappa, basis: (None, (kappa - least) ** 2 if basis is hat else np.inf))
    monkeypatch.setattr(module, "proved", lambda *_: GOOD)
    found, parameters, said = module.settled(here, cast(Any, None), term(None, begin))
    return found, parameters["kappa"], said, tried


@pytest.mark.parametrize(("overshoots", "words"), [(1.0, ""), (2.0, ""), (0.05, UNSETTLED)], ids=["at once", "to and fro", "crawls"])
def test_parameters_that_go_to_and_fro_settle(monkeypatch: pytest.MonkeyPatch, overshoots: float, words: str) -> None:
    """Twice the way goes to and fro without end."""
    _, kappa, said, _ = stepping(monkeypatch, overshoots)
    assert said == words and (words or kappa == pytest.approx(130.0, abs=1.0))


def test_a_step_that_turned_back_once_does_not_halve_all_that_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    """It went too far once. The step back is halved; the one after it goes on, and is taken whole."""
    _, kappa, said, tried = stepping(monkeypatch, 1.9, 1.0)
    assert tried == pytest.approx([148.0, 139.0, 130.0]) and (kappa, said) == (pytest.approx(130.0), "")


@pytest.mark.parametrize(("overshoots", "most"), [(2.6, np.inf), (1.0, 129.8)], ids=["leaves more", "cannot be run"])
def test_a_step_goes_no_farther_than_the_sum_of_squares_falls(monkeypatch: pytest.MonkeyPatch, overshoots: float, most: float) -> None:
    """2.6 times the way leaves more, so less of it is taken. So it is of one that cannot be run, and of the next, until little is left."""
    _, kappa, said, tried = stepping(monkeypatch, overshoots, most=most)
    assert said == "" and kappa == pytest.approx(130.0, abs=1.0)
    whole = 110.0 + overshoots * 20.0
    assert [k for k in tried if abs(k - whole) < 1e-6] == [whole], "the next step begins by the damping before the one that was taken"


def test_where_parameters_have_settled_from_the_first_rounding_does_not_unsettle_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sum of squares rises by less than a small part of a standard error makes."""
    _, kappa, said, tried = stepping(monkeypatch, 1.0, least=129.78, begin=129.8)
    assert (kappa, said, tried) == (130.0, "", [130.0])


def test_where_no_part_of_a_step_leaves_less_it_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    found, kappa, said, _ = stepping(monkeypatch, 1.0, least=100.0)
    assert said == UNSETTLED and kappa == 110.0 and found.bare == 110.0


def test_where_no_part_of_a_step_can_be_run_the_term_stays_at_the_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    found, kappa, said, _ = stepping(monkeypatch, 1.0, most=111.0)
    assert kappa == 110.0 and found.bare == 110.0
    assert said == "the term is that at the optimum without it: beside it the run failed (no equilibrium at 111.818)"


@dataclass(frozen=True)
class Hats:
    """A field of hats, as far as a choice between these and steps looks at it."""

    after: Any
    proof: Any


@pytest.mark.parametrize("kind", ["jaws", "jaw_upper", "gradient", "strain", "scale", "offset", "flux"])
def test_what_drifts_is_no_step(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    """A lamp and a camera's offset may jump; jaws, the scale of cameras and a gradient over an image do not."""
    here: Any = SimpleNamespace(rows=None, split=None)
    hat: Any = SimpleNamespace(kind=kind)
    monkeypatch.setattr(module, "likeliest", lambda *_: 1.0)
    monkeypatch.setattr(module, "field_of", lambda *_: Hats(None, None))
    monkeypatch.setattr(module, "in_steps", lambda *_: "steps")
    monkeypatch.setattr(module, "better", lambda *_: False)
    assert cast(Any, over_time(cast(Any, None), hat, here)) == ("steps" if kind in ("offset", "flux") else Hats(None, None))
    assert KINDS[kind].drifts is (kind not in ("offset", "flux"))
