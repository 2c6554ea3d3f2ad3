"""The rules of what is unlisted, one at a time: what stands out, what explains it, what is believed, what is taken back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from thermofit.diagnose import unlisted as module
from thermofit.diagnose import unlisted_loop as loop
from thermofit.diagnose.held_out import Proof, Rows
from thermofit.diagnose.unlisted import closer_grid, sought, unlisted
from thermofit.diagnose.unlisted_field import believed
from thermofit.diagnose.unlisted_loop import imitates, in_their_stead, needed_elsewhere, resembled_by, terms_of
from thermofit.diagnose.unlisted_place import compact, when_of
from thermofit.diagnose.unlisted_structure import ChannelBlocks, Structure, alternating
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.memory import differences

GOOD = Proof(2.0, 1.0, {}, 0.5, 0.01, 5)


def blocks(noise: float = 1.0, numerical: float = 0.0) -> ChannelBlocks:
    """Two blocks of four rows each."""
    return ChannelBlocks("theta", np.arange(8), np.repeat([0, 1], 4), np.full(2, 4.0), np.full(2, noise), np.full(2, numerical), np.ones(8))


def test_excess_is_beyond_noise_and_discretisation() -> None:
    """Sums 8 and -4 of four rows: 16 + 4, less v and less the numerical part of each block."""
    residual = np.repeat([2.0, -1.0], 4)
    assert blocks().excess(residual) == 18.0 and blocks(3.0, 2.0).excess(residual) == 10.0
    assert blocks(3.0).spread == pytest.approx(6.0)


def weights_of(added: list[float]) -> dict[int, Any]:
    """Weights of the one channel of a record to which an error of its instrument that lasts would add this, where one fitted parameter is a
    shift of all rows."""
    missing = SimpleNamespace(
        records=("pull",), of_instruments={"theta": ("clock",)}, grid=lambda *_: SimpleNamespace(size=1), answers=lambda *_: np.array(added)
    )
    model: Any = SimpleNamespace(missing=missing, comparisons=[SimpleNamespace(n=8)], columns=lambda a: {0: a[:, None]})
    fitted: Any = SimpleNamespace(residual=np.zeros(8), projected=lambda whole: whole - whole.mean())
    return alternating(cast(Any, SimpleNamespace(model=model, parameters=None)), fitted)


def test_rows_are_weighted_by_what_an_instrument_adds_beside_the_parameters() -> None:
    """Of mean square one. A block to which it adds nothing has its own sum then, and what parameters take wholly is no weight."""
    (weight,) = weights_of([3.0, 1.0, 3.0, 1.0, 2.0, 2.0, 2.0, 2.0])[0]
    assert weight == pytest.approx(np.sqrt(2.0) * np.array([1, -1, 1, -1, 0, 0, 0, 0]), abs=1e-5)
    count = np.bincount(np.repeat([0, 1], 4), weight**2)
    weighted = ChannelBlocks("theta", np.arange(8), np.repeat([0, 1], 4), count, np.zeros(2), np.zeros(2), weight)
    assert weighted.excess(np.array([1.0, -1.0, 1.0, -1.0, 2.0, 2.0, 2.0, 2.0])) == pytest.approx(4.0 + 16.0, rel=1e-4)
    assert weights_of([5.0] * 8) == {}


@pytest.mark.parametrize(("excess", "out"), [(7.9, False), (8.1, True)])
def test_structure_stands_out_by_four_standard_deviations(excess: float, out: bool) -> None:
    """sqrt(2 (1 + 1)) = 2."""
    assert Structure(blocks(), excess, 0.1).stands_out is out


def test_noise_is_that_of_second_differences() -> None:
    """A wrong sigma is noise, a slope is not: v = 9 for noise three times as large."""
    r = 3.0 * np.random.default_rng(1).normal(size=4000)
    place, time = np.zeros(4000, dtype=int), np.arange(4000)
    assert differences(r, place, time) == (pytest.approx(9.0, rel=0.1), 3998)
    assert differences(r + 0.5 * time, place, time)[0] == pytest.approx(differences(r, place, time)[0], rel=1e-6)


@pytest.mark.parametrize(("gain", "sigma", "asked"), [(0.1, 0.033, True), (0.1, 0.034, False), (0.0051, 1e-6, True), (0.0049, 1e-6, False)])
def test_a_field_is_believed_by_three_standard_errors_and_what_is_worth_it(gain: float, sigma: float, asked: bool) -> None:
    field: Any = SimpleNamespace(proof=replace(GOOD, gain=gain, sigma=sigma))
    assert believed(field) is asked


@pytest.mark.parametrize(("explained", "missing"), [(0.49, True), (0.51, False)])
def test_an_effect_that_takes_half_is_the_answer(monkeypatch: pytest.MonkeyPatch, explained: float, missing: bool) -> None:
    """Only one that is still worth a refit."""
    here: Any = SimpleNamespace(
        ranking=SimpleNamespace(scores=(SimpleNamespace(effect="lamp"), SimpleNamespace(effect="refused"))),
        case=SimpleNamespace(parameters=None),
    )
    monkeypatch.setattr(module, "best_listed", lambda _here, _s, names: ("refused", 0.9) if "refused" in names else ("lamp", explained))
    monkeypatch.setattr(module, "term_of", lambda *_: None)
    monkeypatch.setattr(module, "through_surface", lambda *_: None)
    monkeypatch.setattr(module, "of_instrument", lambda *_: None)
    monkeypatch.setattr(module, "kind_of", lambda *_: "")
    found = unlisted(here, [Structure(blocks(), 100.0, 0.1)], ["lamp"])
    assert (found is not None) is missing and (found is None or found.listed == ("refused", 0.9))


SMOOTH, WILD = np.full(40, 3.0), np.concatenate([np.zeros(38), np.full(2, 40.0)])
"""Residuals of 40 values: all off by three times their noise; two by forty times."""


@pytest.mark.parametrize(
    ("coupon", "left", "base", "law", "told"),
    [
        (True, SMOOTH, None, False, True),
        (False, SMOOTH, None, False, False),  # a body's blocks stand out by its mesh
        (True, WILD, None, False, False),  # wild samples are no structure
        (True, SMOOTH, 8.0 * SMOOTH, False, False),  # an effect has taken all but a sixty-fourth
        (True, SMOOTH, 6.0 * SMOOTH, False, True),
        (True, WILD, None, True, True),  # held-out data ask for a law over the state
    ],
)
def test_a_channel_whose_term_held_out_data_do_not_ask_for(
    monkeypatch: pytest.MonkeyPatch, coupon: bool, left: np.ndarray, base: np.ndarray | None, law: bool, told: bool
) -> None:
    """On a coupon the structure alone is told, on a body nothing is."""
    channel = ChannelBlocks("stress", np.arange(40), np.zeros(40, dtype=int), np.array([40.0]), np.ones(1), np.zeros(1), np.ones(40))
    here: Any = SimpleNamespace(
        ranking=SimpleNamespace(scores=()),
        case=SimpleNamespace(parameters=None, model=SimpleNamespace(segments=() if coupon else None)),
        problem=SimpleNamespace(model=SimpleNamespace(left=left)),
    )
    term: Any = SimpleNamespace(field=SimpleNamespace(proof=GOOD if law else replace(GOOD, gain=0.0)))
    monkeypatch.setattr(module, "best_listed", lambda *_: ("", 0.0))
    monkeypatch.setattr(module, "term_of", lambda *_: None)
    monkeypatch.setattr(module, "through_surface", lambda *_: None)
    monkeypatch.setattr(module, "of_instrument", lambda *_: None)
    monkeypatch.setattr(module, "kind_of", lambda *_: "stress")
    monkeypatch.setattr(module, "state_law", lambda *_: term)
    found = unlisted(here, [Structure(channel, channel.excess(left), 0.1)], [], base)
    assert (found is not None) is told and (found is None or (found.field is None and found.law is term))


@pytest.mark.parametrize(
    ("rows", "smooth", "there"),
    [(5, False, True), (4, False, False), (4, True, True)],  # structure besides the wild samples is told, without the term
)
def test_a_term_within_whose_window_are_fewer_than_five_values_is_wild_samples(
    monkeypatch: pytest.MonkeyPatch, rows: int, smooth: bool, there: bool
) -> None:
    """Of 20 values of a coupon, one a second, the term has every second one."""
    term: Any = SimpleNamespace(basis=SimpleNamespace(rows=np.arange(0, 20, 2), grid=SimpleNamespace(places=2)), proof=GOOD)
    channel = ChannelBlocks("theta", np.arange(20), np.zeros(20, dtype=int), np.array([20.0]), np.ones(1), np.zeros(1), np.ones(20))
    left = np.full(20, 3.0) if smooth else np.concatenate([np.zeros(19), [40.0]])
    here: Any = SimpleNamespace(
        ranking=SimpleNamespace(scores=()),
        case=SimpleNamespace(parameters=None, model=SimpleNamespace(segments=())),
        rows=SimpleNamespace(time=np.arange(20.0)),
        problem=SimpleNamespace(model=SimpleNamespace(left=left)),
    )
    monkeypatch.setattr(module, "through_surface", lambda *_: None)
    monkeypatch.setattr(module, "of_instrument", lambda *_: None)
    monkeypatch.setattr(module, "kind_of", lambda *_: "heat")
    monkeypatch.setattr(module, "best_listed", lambda *_: ("", 0.0))
    monkeypatch.setattr(module, "term_of", lambda *_: term)
    monkeypatch.setattr(module, "settled", lambda *_: (term, None, ""))
    monkeypatch.setattr(module, "undriven", lambda here, _: (here, ""))
    monkeypatch.setattr(module, "volumes", lambda *_: None)
    monkeypatch.setattr(module, "hints_of", lambda *_: ())
    monkeypatch.setattr(module, "place_of", lambda *_: SimpleNamespace(when=(4.0, 4.0 + 2.0 * (rows - 1))))
    found = unlisted(here, [Structure(channel, channel.excess(left), 0.1)], [])
    assert (found is not None) is there and (found is None or (found.field is term) == (rows == 5))


@dataclass(frozen=True)
class Model:
    """Predicts nothing; its bounds do not matter."""

    bounds: Any = None
    noise: Any = None

    def predicted(self, _: Any) -> np.ndarray:
        return np.zeros(2)


@dataclass(frozen=True)
class Term:
    """What is compared of a term."""

    name: str
    basis: Any = None
    before: Any = None
    after: Any = None
    residual: Any = None
    proof: Proof = GOOD


@pytest.mark.parametrize(
    ("better", "near", "taken"),
    [(True, 1.0, "protected"), (True, 0.5, "optimum"), (True, None, "protected"), (False, 1.0, "optimum")],
    ids=["as well at the optimum", "worse than at the optimum", "none at the optimum", "no better than without"],
)
def test_a_heat_at_protected_parameters_has_to_predict_better_than_the_optimum(
    monkeypatch: pytest.MonkeyPatch, better: bool, near: float | None, taken: str
) -> None:
    """Beside protected parameters a fit without it is no rival: held-out data are compared with the optimum's, without and with a term
    there; else it is sought there."""
    rows = Rows(np.zeros(200, dtype=int), np.arange(200.0), np.zeros((200, 2)), np.zeros(200, dtype=int))
    here: Any = SimpleNamespace(problem=SimpleNamespace(model=Model()), split=SimpleNamespace(folds=[], held_out=(None,) * 5), rows=rows)
    there: Any = SimpleNamespace()
    left = np.random.default_rng(2).normal(size=200)
    optimum = None if near is None else Term("optimum", after=near * left, residual=left)
    terms = {id(here): optimum, id(there): Term("protected", after=left, residual=left)}
    monkeypatch.setattr(module, "term_of", lambda where, _: terms[id(where)])
    monkeypatch.setattr(module, "proved", lambda *_: GOOD if better else replace(GOOD, gain=0.001))
    term, where = sought(here, there, cast(Any, None))
    assert cast(Any, term).name == taken and (where is there) is (taken == "protected")


@pytest.mark.parametrize(("worse", "closer"), [(0.09, True), (0.11, False)])
def test_fewer_hats_are_taken_unless_held_out_data_ask_for_all(worse: float, closer: bool) -> None:
    """A tenth of the held-out error without a term is the standard error."""
    basis = SimpleNamespace(rows=np.arange(4))
    whole: Any = SimpleNamespace(basis=basis, before=np.ones(6), after=np.zeros(6), proof=replace(GOOD, sigma=0.1))
    close: Any = SimpleNamespace(basis=basis, after=np.full(6, np.sqrt(worse)))
    assert (closer_grid(whole, close) is close) is closer


def test_the_window_is_where_the_term_is_above_half_of_its_plateau() -> None:
    """A plateau of 2 with a peak of 3: half of the median of the upper values, crossed on straight lines."""
    time, part = np.arange(10.0), np.zeros(10, dtype=int)
    level = np.array([0.0, 0.0, 2.0, 2.0, 3.0, 2.0, 2.0, 0.0, 0.0, 0.0])
    assert when_of(time, part, level) == pytest.approx((1.5, 6.5)) and when_of(time, part, -level) == pytest.approx((1.5, 6.5))
    assert when_of(time, np.repeat([0, 1], 5), level)[1] == 4.0, "it ends with its record"


def patch(values: list[float], sigma: list[float]) -> list[bool]:
    """Places along y of a term that is the same at three times."""
    v, s = (np.tile(np.array(a)[None, :, None, None], (3, 1, 1, 1)) for a in (values, sigma))
    return compact(v, s)[:, 0].tolist()  # type: ignore[no-any-return]


def test_a_place_belongs_to_the_term_from_three_tenths_of_the_largest() -> None:
    """Both as it is and over its standard error, and where it hangs together with the clearest one."""
    one = [1.0] * 6
    assert patch([0.29, 0.31, 1.0, 0.31, 0.1, 0.9], one) == [False, True, True, True, False, False]
    assert patch(one, [1.1, 4.0, 1.0, 3.0, 3.0, 3.4]) == [False, False, True, True, True, False]
    assert patch([1.0, 0.0, 0.6, 0.6, 0.0, 0.0], [10.0, 10.0, 1.0, 1.0, 10.0, 10.0])[2:4] == [True, True], "the clearest, not the largest"


def closed_of(first: float = 1000.0, accepted: tuple[str, ...] = ("a", "b", "c"), cheap: bool = False) -> Any:
    split, problem = SimpleNamespace(held_out=()), SimpleNamespace(model=SimpleNamespace(noise=None))
    columns = SimpleNamespace(residual=first, fitted=None)
    last = SimpleNamespace(
        case=SimpleNamespace(cheap=cheap, model=SimpleNamespace(priors=()), parameters=None),
        columns=columns,
        rows=None,
        split=split,
        problem=problem,
    )
    return SimpleNamespace(first=SimpleNamespace(columns=columns), last=last, accepted=accepted)


@dataclass(frozen=True)
class Standing:
    """A structure that stands out above an excess of 50; beside a field in the stead of effects it holds `left`."""

    excess: float
    left: float = 0.0

    @property
    def blocks(self) -> Any:
        return SimpleNamespace(excess=lambda residual: self.left if residual == "alone" else residual)

    @property
    def stands_out(self) -> bool:
        return self.excess > 50.0


def structure_of(excess: float, left: float = 0.0) -> Any:
    return Standing(excess, left)


@pytest.mark.parametrize(
    ("excess", "needed", "taken"), [(99.0, False, False), (101.0, False, True), (101.0, True, False)], ids=["cause", "resembles", "needed"]
)
def test_what_leaves_a_tenth_and_is_not_needed_beside_the_field_only_resembles(
    monkeypatch: pytest.MonkeyPatch, excess: float, needed: bool, taken: bool
) -> None:
    """Of an excess of 1000 at first. One spot is not all that is missing without it."""
    monkeypatch.setattr(loop, "one_spot_instead", lambda *_: None)
    monkeypatch.setattr(loop, "without_effects", lambda *_: None)
    monkeypatch.setattr(loop, "field_of", lambda *_: SimpleNamespace(after=None))
    monkeypatch.setattr(loop, "compared", lambda *_: GOOD if needed else replace(GOOD, sigma=0.3))
    found: Any = SimpleNamespace(structure=structure_of(excess), law=None)
    field: Any = SimpleNamespace(basis=SimpleNamespace(kind="heat"), after=None, steps=())
    assert resembled_by(closed_of(), ("a",), found, field)[0] is taken
    over_state: Any = SimpleNamespace(basis=SimpleNamespace(kind="stress"), after=None, steps=())
    of_law: Any = SimpleNamespace(structure=found.structure, law=SimpleNamespace(field=over_state))
    for another_form in (True, False):
        monkeypatch.setattr(loop, "imitates", lambda model, known, law, said=another_form: said)
        assert resembled_by(closed_of(), ("a",), of_law, over_state)[0] is (taken and not another_form)
    monkeypatch.setattr(loop, "field_of", lambda *_: pytest.fail("hats in the stead of steps would hold against the effect what they miss"))
    monkeypatch.setattr(loop, "over_time", lambda *_: SimpleNamespace(after=None))
    steps: Any = SimpleNamespace(basis=SimpleNamespace(kind="flux"), after=None, steps=((30.0, 0.01),))
    assert resembled_by(closed_of(), ("a",), found, steps)[0] is taken
    stress: Any = SimpleNamespace(basis=SimpleNamespace(kind="stress"), after=None)
    for known in (found, of_law):
        assert not resembled_by(closed_of(), ("a",), known, stress)[0], "a stress over time follows whatever is smooth"
    for kind in ("strain", "scale", "displacement"):
        cameras: Any = SimpleNamespace(basis=SimpleNamespace(kind=kind), after=None, steps=((30.0, 0.01),))
        assert not resembled_by(closed_of(), ("hardening_curve",), found, cameras)[0], "it follows the flow under a force, whatever that is"
        assert resembled_by(closed_of(), ("dic_tilt",), found, cameras)[0] is taken
    monkeypatch.setattr(loop, "contradicted", lambda *_: ("theta_air",))
    assert resembled_by(closed_of(), ("a",), found, steps)[0] is not needed, "what drives a declared reading is no answer"


@pytest.mark.parametrize(("excess", "needed"), [(99.0, False), (99.0, True), (101.0, False)], ids=["answers", "needed", "leaves more"])
def test_what_answers_is_held_against_one_spot(monkeypatch: pytest.MonkeyPatch, excess: float, needed: bool) -> None:
    """Beside a field of heat no heat is needed. Nothing else is asked for a spot, nor is what leaves more than a tenth."""
    monkeypatch.setattr(loop, "without_effects", lambda *_: None)
    monkeypatch.setattr(loop, "field_of", lambda *_: SimpleNamespace(after=None))
    monkeypatch.setattr(loop, "compared", lambda *_: GOOD if needed else replace(GOOD, sigma=0.3))
    found: Any = SimpleNamespace(structure=structure_of(excess), law=None)
    heat, other = (cast(Any, SimpleNamespace(basis=SimpleNamespace(kind=k), after=None, steps=())) for k in ("heat", "flux"))
    asked: list[Any] = []
    for spot in (SimpleNamespace(), None):
        monkeypatch.setattr(loop, "one_spot_instead", lambda *given, said=spot: asked.append(given[1]) or said)
        answers = excess < 100.0
        told = resembled_by(closed_of(), ("a",), found, heat)
        assert told == (not needed and (spot is not None or not answers), spot if answers and not needed else None)
        assert resembled_by(closed_of(), ("a",), found, other)[0] is (not needed and not answers)
    assert asked == ([("a",), ("a",)] if excess < 100.0 and not needed else [])


@pytest.mark.parametrize(("beside", "same"), [(0.3, True), (0.4, False)])
def test_a_law_is_another_form_of_what_it_leaves_less_than_a_tenth_of(beside: float, same: bool) -> None:
    """What the effect does is 1 along the law, `beside` across it, and 5 along a parameter, which takes that: 0.09 and 0.16 of one."""
    parameter, law, across = np.eye(6)[[0, 2, 4]]
    residual = np.arange(6.0)
    fitted = LinearModel(residual, np.column_stack([parameter, law]))
    without = LinearModel(residual + law + beside * across + 5.0 * parameter, parameter[:, None])
    basis: Any = SimpleNamespace(rows=np.array([2, 3]), columns=2.0 * law[[2, 3], None])
    assert imitates(fitted, without, basis) is same


@pytest.mark.parametrize(("sigma", "asked"), [(0.033, True), (0.034, False)])
def test_effects_are_asked_for_again_beside_the_field_and_a_law_that_held_out_data_ask_for(sigma: float, asked: bool) -> None:
    field, law = SimpleNamespace(), SimpleNamespace(field=SimpleNamespace(proof=replace(GOOD, gain=0.1, sigma=sigma)))
    beside = [law.field] if asked else []
    for known, own in ((field, [field]), (None, [])):
        found: Any = SimpleNamespace(field=known, law=law)
        assert terms_of(found) == [*own, *beside]
        assert terms_of(cast(Any, SimpleNamespace(field=known, law=None))) == own


def stead(
    monkeypatch: pytest.MonkeyPatch,
    gains: dict[str, tuple[float, float]],
    needed: bool = False,
    excess: float = 500.0,
    cheap: bool = False,
    camera: bool = False,
    by_cameras_alone: bool = False,
    left: float = 60.0,
    kind: str = "heat",
    accepted: tuple[str, ...] = ("a", "b", "c"),
    elsewhere: bool = False,
) -> tuple[str, ...]:
    """Effects in whose stead a field gains so much, (gain, its standard error); others nothing."""

    class Hat:
        rows = slice(None)

        def __init__(self) -> None:
            self.kind = kind

    def field(known: Any, *_: Any) -> Any:
        return SimpleNamespace(after=np.array([known if isinstance(known, str) else ""]), residual="alone")

    def compare(before: Any, after: np.ndarray, *_: Any) -> Proof:
        if after[0] == "":
            return GOOD if needed else replace(GOOD, sigma=0.3)
        gain, sigma = gains.get(after[0], (0.0, 0.01))
        return replace(GOOD, gain=gain, sigma=sigma)

    monkeypatch.setattr(loop, "broad_basis", lambda *_: Hat())
    monkeypatch.setattr(loop, "camera_bases", lambda *_: [Hat()] if camera else [])
    monkeypatch.setattr(loop, "without_effects", lambda _here, names: " ".join(names))
    monkeypatch.setattr(loop, "rows_of", lambda *_: None)
    monkeypatch.setattr(loop, "needed_elsewhere", lambda *_: elsewhere)
    monkeypatch.setattr(loop, "held_out_of", lambda *_: np.array(["now"]))
    monkeypatch.setattr(loop, "field_of", field)
    monkeypatch.setattr(loop, "compared", compare)
    return in_their_stead(closed_of(cheap=cheap, accepted=accepted), [structure_of(excess, left)], by_cameras_alone)


def test_a_field_in_the_stead_of_effects_has_to_gain_surely_and_most(monkeypatch: pytest.MonkeyPatch) -> None:
    assert stead(monkeypatch, {"a": (0.1, 0.033)}) == ("a",) and stead(monkeypatch, {"a": (0.1, 0.034)}) == ()
    assert stead(monkeypatch, {"a": (0.0049, 1e-6)}) == () and stead(monkeypatch, {"a": (0.0051, 1e-6)}) == ("a",)
    assert stead(monkeypatch, {"a": (0.1, 0.01), "a c": (0.3, 0.01), "a b c": (0.2, 0.01)}) == ("a", "c")


def test_no_field_stands_in_the_stead_of_effects_that_are_needed_or_leave_little(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor of those of coupons."""
    gains = {"a": (0.3, 0.01)}
    assert stead(monkeypatch, gains, excess=101.0) == ("a",) and stead(monkeypatch, gains, excess=99.0) == ()
    assert stead(monkeypatch, gains, needed=True) == () and stead(monkeypatch, gains, cheap=True) == ()


@pytest.mark.parametrize(("kind", "taken"), [("heat", ("hardening_curve",)), ("displacement", ()), ("scale", ())])
def test_no_displacement_stands_in_the_stead_of_a_curve_of_any_form(
    monkeypatch: pytest.MonkeyPatch, kind: str, taken: tuple[str, ...]
) -> None:
    """It follows the flow, and says less; of what is a name it may well."""
    gains = {"hardening_curve": (0.3, 0.01), "rate_power": (0.2, 0.01)}
    assert stead(monkeypatch, gains, kind=kind, accepted=("hardening_curve",)) == taken
    assert stead(monkeypatch, gains, kind=kind, accepted=("rate_power",)) == ("rate_power",)


def test_what_the_camera_adds_is_asked_for_however_little_they_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    """And where another term has been found beside them."""
    gains = {"a": (0.3, 0.01)}
    assert stead(monkeypatch, gains, excess=1.0, camera=True) == ("a",) and stead(monkeypatch, gains, excess=1.0) == ()
    assert (
        stead(monkeypatch, gains, camera=True, by_cameras_alone=True) == ("a",) and stead(monkeypatch, gains, by_cameras_alone=True) == ()
    )
    assert stead(monkeypatch, gains, needed=True, excess=1.0, camera=True) == ()
    assert stead(monkeypatch, gains, needed=True, excess=1.0, camera=True, left=40.0) == ("a",), "it leaves nothing"
    assert stead(monkeypatch, gains, needed=True, excess=1.0, camera=True, left=40.0, elsewhere=True) == (), "what displacements need stays"
    assert stead(monkeypatch, gains, needed=True, left=40.0) == (), "a broad heat leaves nothing of anything"


@pytest.mark.parametrize("helps", [True, False])
def test_what_other_channels_need_is_needed(helps: bool) -> None:
    """A curve of hardening takes what displacements miss; an offset of the infrared camera takes nothing of that."""
    random, n = np.random.default_rng(4), 600
    rows = Rows(np.repeat([0, 1], n // 2), np.tile(np.linspace(0.0, 100.0, n // 2), 2), np.zeros((n, 2)), np.zeros(n, dtype=int))
    with_both: Any = SimpleNamespace(after=random.normal(size=n))
    alone: Any = SimpleNamespace(after=with_both.after + np.where(rows.channel == (0 if helps else 1), 2.0 * random.normal(size=n), 0.0))
    here: Any = SimpleNamespace(rows=rows, split=SimpleNamespace(held_out=(None,) * 5))
    hat: Any = SimpleNamespace(rows=np.flatnonzero(rows.channel == 1))
    assert needed_elsewhere(here, hat, alone, with_both) is helps
    every: Any = SimpleNamespace(rows=np.arange(n))
    assert not needed_elsewhere(here, every, alone, with_both)
