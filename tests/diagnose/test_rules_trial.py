"""The rules by which a refit is made and refused, one at a time: everything else lets it pass, so that each stands for itself."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose import trace
from thermofit.diagnose import trial as module
from thermofit.diagnose.held_out import Proof, Rows, Split
from thermofit.diagnose.refit import EXPONENTS
from thermofit.diagnose.trial import (
    NEARER,
    Trial,
    cools_from,
    discriminated,
    ended_at,
    freed_refit,
    nearer,
    on_readings,
    refusal,
    surely_better,
    tried,
    tried_together,
    worth_of,
)
from thermofit.effects.catalogue import effect
from thermofit.experiment.trust import physical
from thermofit.fit.linear_model import LinearModel

RATE = "ir_drift.rate"
SLOPE = "stored_energy.slope"
GOOD = Proof(2.0, 1.0, {}, 0.5, 0.01, 5)
BASE = Parameters.of({"kappa": 120.0, "c0": 2.3})
PAIR = ("second_hardening", "air_drift")
WITH_EXPONENTS = BASE.replace(**{n: param(n).neutral for name in PAIR for n in effect(name).names}).with_free(
    ("kappa", *(effect(name).amplitude.name for name in PAIR))
)


def refused(
    monkeypatch: pytest.MonkeyPatch,
    estimate: float = 0.02,
    sigma: float = 1e-3,
    proof: Proof = GOOD,
    *,
    fitted: Any = (1.0,),
    at: bool = False,
    misses: float = 0.0,
    bounds: Any = physical,
) -> str:
    """What is said of a drift that everything speaks for, but for what is given."""
    monkeypatch.setattr(module, "missed", lambda *_: misses)
    fit: Any = SimpleNamespace(sigma=fitted, at_bound=[at], names=(RATE,))
    there: Any = SimpleNamespace(case=SimpleNamespace(bounds=bounds))
    return refusal(there, [effect("ir_drift")], {RATE: estimate}, {RATE: sigma}, proof, fit)


@pytest.mark.parametrize("at", ["ir_registration.shift_y", "ir_registration.scale", ""])
def test_any_amplitude_at_a_bound_refuses_an_effect(monkeypatch: pytest.MonkeyPatch, at: str) -> None:
    """Not the first one alone."""
    monkeypatch.setattr(module, "missed", lambda *_: 0.0)
    names = tuple(p.name for p in effect("ir_registration").amplitudes)
    fit: Any = SimpleNamespace(sigma=(1.0,), at_bound=[n == at for n in names], names=names)
    there: Any = SimpleNamespace(case=SimpleNamespace(bounds=physical))
    found = refusal(there, [effect("ir_registration")], dict.fromkeys(names, 0.01), dict.fromkeys(names, 1e-3), GOOD, fit)
    assert found.startswith(f"{at} ends at its bound: 0.01") if at else found == ""


def test_an_effect_that_all_speaks_for_is_not_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert refused(monkeypatch) == ""


def test_a_refit_without_standard_errors_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert refused(monkeypatch, fitted=None).startswith("the refit has no standard errors")


@pytest.mark.parametrize(
    ("gain", "sigma", "said"),
    [
        (0.02, 0.0101, "falls by 2.00 % +- 1.01 % only"),
        (0.0029, 1e-5, "falls by 0.29 % +- 0.00 % only"),
        (-0.5, 0.01, "rises by 50.00 % +- 1.00 %"),
    ],
    ids=["within its errors", "of no worth", "against it"],
)
def test_a_gain_that_does_not_convince_is_refused(monkeypatch: pytest.MonkeyPatch, gain: float, sigma: float, said: str) -> None:
    assert refused(monkeypatch, proof=replace(GOOD, gain=gain, sigma=sigma)) == f"held-out error {said}"


@pytest.mark.parametrize(("value", "ends"), [(0.0991, True), (-0.0991, True), (0.0989, False), (-0.0989, False)])
def test_an_amplitude_within_one_per_cent_of_its_bound_is_refused(monkeypatch: pytest.MonkeyPatch, value: float, ends: bool) -> None:
    assert ("ends at its bound" in refused(monkeypatch, value)) is ends


def test_an_amplitude_that_the_fit_says_is_at_its_bound_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "ends at its bound" in refused(monkeypatch, at=True)


def test_the_bounds_are_those_of_the_study(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "bounds 0 to 0.05" in refused(monkeypatch, 0.0499, bounds=lambda _: (0.0, 0.05))


@pytest.mark.parametrize(("away", "misses", "near"), [(1.9, 0.0, True), (-1.9, 1.9, True), (2.1, 0.0, False), (1.9, 2.1, False)])
def test_an_amplitude_within_two_standard_errors_of_neutral_is_refused(
    monkeypatch: pytest.MonkeyPatch, away: float, misses: float, near: bool
) -> None:
    """Unless temperatures miss it by more than two on the known motion."""
    assert ("is not away from 0" in refused(monkeypatch, away * 1e-3, misses=misses)) is near


def flowing(slope: float, largest: float) -> Any:
    """A trace at a share of the stored energy, with flow up to a plastic strain."""
    strain = np.linspace(0.0, largest, 101)
    case = SimpleNamespace(
        parameters=BASE.replace(**{SLOPE: slope}), flow=lambda: (strain, 0.0 * strain, 0.0 * strain + 293.0), bounds=physical
    )
    return SimpleNamespace(case=case)


@pytest.mark.parametrize(
    ("slope", "sigma", "largest", "strain"),
    [
        (-12.5, 0.0, 0.1, 0.081),
        (-12.5, 0.0, 0.0799, None),
        (-12.5, 0.625, 0.1, 0.089),
        (-12.5, 1.26, 0.1, None),
        (12.5, 0.0, 0.1, None),
        (0.0, 1.0, 0.1, None),
    ],
    ids=["cools", "releases all the way", "by two standard errors", "within two", "heats", "neutral"],
)
def test_flow_releases_heat_within_the_errors_of_its_share(slope: float, sigma: float, largest: float, strain: float | None) -> None:
    """1 + slope Lambda is below nothing beyond -1 / slope."""
    found = cools_from(flowing(slope, largest), effect("stored_energy"), {SLOPE: sigma})
    assert found == (None if strain is None else pytest.approx(strain, abs=1e-9))


def test_only_what_acts_on_the_share_that_becomes_heat_is_asked_for_it() -> None:
    """Softening takes from the stress; that its law stores more than is left is no reason against it."""
    assert cools_from(None, effect("thermal_softening"), {}) is None  # type: ignore[arg-type]


@pytest.mark.parametrize(("largest", "said"), [(0.1, "flow would take up heat from a plastic strain of 0.081 on"), (0.05, "")])
def test_an_effect_by_which_flow_would_cool_is_refused(largest: float, said: str) -> None:
    fit: Any = SimpleNamespace(sigma=(0.01,), at_bound=[False], names=(SLOPE,))
    found = refusal(flowing(-12.5, largest), [effect("stored_energy")], {SLOPE: -12.5}, {SLOPE: 0.01}, GOOD, fit)
    assert said in found and bool(said) is bool(found)


def of(name: str, size: float = 0.02) -> Any:
    return SimpleNamespace(effect=name, estimate={effect(name).amplitude.name: size})


def here_of(parameters: Parameters = BASE, **case: Any) -> Any:
    split = SimpleNamespace(held_out=(None,) * 5)
    problem = SimpleNamespace(model=SimpleNamespace(noise=None))
    return SimpleNamespace(
        case=SimpleNamespace(parameters=parameters, **{"bounds": physical, "cheap": False, **case}),
        rows=None,
        split=split,
        problem=problem,
        columns=SimpleNamespace(residual=None),
        shown={},
        from_displacements={},
        unpredicted={},
        scanned={},
        settings={},
    )


@pytest.mark.parametrize("largest", [1.0, 0.3, 0.02])
def test_a_refit_that_cannot_be_run_begins_nearer_to_neutral(largest: float) -> None:
    """The starts are those parts of the estimate, in turn, up to the first that can be run."""
    begun = []

    def refit(start: Parameters, label: str, **_: Any) -> Any:
        begun.append(start[RATE] / 0.02)
        if start[RATE] > 0.02 * largest + 1e-9:
            raise NumericsError("no equilibrium")
        return start, label

    found = nearer(here_of(), (of("ir_drift"),), {}, refit)
    expected = [part for part in NEARER if part > largest]
    expected.append(NEARER[len(expected)])
    assert begun == pytest.approx(expected, abs=1e-4) and not isinstance(found, str)


def test_where_no_start_can_be_run_the_first_reason_is_said() -> None:
    begun = []

    def refit(start: Parameters, label: str, **_: Any) -> Any:
        begun.append(label)
        raise NumericsError(f"broken {len(begun)}")

    assert str(nearer(here_of(), (of("ir_drift"),), {}, refit)).startswith("broken 1 (nor can it be run from 0.0156")
    assert len(begun) == len(NEARER)


def failing(*_: Any, **__: Any) -> Any:
    raise NumericsError("no equilibrium at 12 s")


def test_a_trial_whose_judgement_fails_is_unjudged_and_touches_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """The refit runs, what follows does not."""
    monkeypatch.setattr(module, "scans", lambda *_: [{}])
    monkeypatch.setattr(module, "ended_at", failing)
    means: Any = SimpleNamespace(refit=lambda start, _, **__: (start, None))
    fit: Any = None
    for trial, found in (
        tried(here_of(), fit, of("ir_drift"), means),
        tried_together(here_of(), fit, (of("ir_drift"), of("ir_gain")), {}, means),
    ):
        assert found is None and trial.unjudged and trial.refused == "a run that judges it failed: no equilibrium at 12 s"


def test_a_trial_that_no_start_runs_is_unjudged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "scans", lambda *_: [{}])
    means: Any = SimpleNamespace(refit=failing)
    fit: Any = None
    single, _ = tried(here_of(), fit, of("ir_drift"), means)
    pair, _ = tried_together(here_of(), fit, (of("ir_drift"), of("ir_gain")), {}, means)
    assert single.unjudged and pair.unjudged and single.refused.startswith("the refit failed: no equilibrium")


@pytest.mark.parametrize(("fall", "worth"), [(9.9, False), (10.1, True)])
def test_exponents_are_fitted_where_the_objective_falls_by_ten(fall: float, worth: bool) -> None:
    start: Any = (WITH_EXPONENTS, SimpleNamespace(f=100.0))
    found, said = freed_refit(start, ("lamp.start",), "lamp", lambda p, _, **__: (p, SimpleNamespace(f=100.0 - fall, converged=True)))  # type: ignore[return-value,arg-type]
    assert (found is not None) is worth and (said == "fitted") is worth
    if found is not None:
        assert "lamp.start" in found[0].free


Judge = Callable[..., tuple[Trial, Any]]


def ended(
    monkeypatch: pytest.MonkeyPatch,
    gains: dict[str, tuple[float, str]],
    freed: dict[tuple[str, ...], bool],
    cheap: bool = True,
    settles: bool | None = False,
    before: Parameters = BASE,
    asked: bool = True,
) -> Trial:
    """The end of two effects with an exponent each: `gains` = (gain, why refused) by what is free, `freed` = what can be freed, and whether
    it settles; `settles`: whether a refit with exponents held where they came to does, None: it cannot be run; `before`: parameters of the
    round; `asked`: whether held-out data ask for exponents of earlier effects."""

    def refit(start: Parameters, label: str, **_: Any) -> Any:
        assert label == f"{' '.join(PAIR)} held there" and not set(BOTH) & set(start.free)
        if settles is None:
            raise NumericsError("no equilibrium")
        return start, SimpleNamespace(converged=settles, of="there")

    def free(end: Any, names: tuple[str, ...], label: str, refit: Any) -> Any:
        if names not in freed:
            return None, "gains nothing"
        return (end[0].with_free((*end[0].free, *names)), SimpleNamespace(converged=freed[names], of=" ".join(names))), "fitted"

    def judge(here: Any, fit: Any, scores: Any, end: Any, means: Any) -> Any:
        gain, why = gains[end[1].of]
        return Trial(tuple(scores), replace(GOOD, gain=gain), {}, {}, 0.0, why), None if why else end[1].of

    monkeypatch.setattr(module, "freed_refit", free)
    monkeypatch.setattr(module, "judged_trial", judge)
    monkeypatch.setattr(module, "asked_for", lambda here, plain, freed: asked)
    means: Any = SimpleNamespace(refit=refit)
    fit: Any = None
    end: Any = (WITH_EXPONENTS, SimpleNamespace(converged=True, of="held"))
    trial, found = ended_at(here_of(before, cheap=cheap), fit, tuple(of(n) for n in PAIR), end, means)
    return replace(trial, exponents=f"{found}: {trial.exponents}")


BOTH = ("second_hardening.b", "air_drift.time")


def test_of_coupons_the_best_end_is_taken_and_not_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    gains = {"held": (0.1, ""), " ".join(BOTH): (0.2, ""), "second_hardening.b": (0.4, ""), "air_drift.time": (0.3, "")}
    every = {BOTH: True, BOTH[:1]: True, BOTH[1:]: True}
    assert ended(monkeypatch, gains, every, asked=False).exponents == "second_hardening.b: second_hardening.b fitted"
    assert ended(monkeypatch, gains, {BOTH: True}).exponents == f"{' '.join(BOTH)}: fitted"
    worse = gains | {" ".join(BOTH): (0.05, "")}
    assert ended(monkeypatch, worse, {BOTH: True}).exponents.endswith("freeing them gains nothing on held-out data")


def test_an_end_that_is_refused_comes_after_one_that_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    gains = {"held": (0.1, ""), " ".join(BOTH): (0.4, "at its bound")}
    assert ended(monkeypatch, gains, {BOTH: True}).refused == ""


def test_exponents_of_earlier_effects_are_fitted_beside_those_that_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where they are held: one that an earlier round has fitted is free already. Alone too, and only where that settles."""
    earlier, C = "backstress_first.gamma", "backstress_first.C"
    before = BASE.replace(**{C: 5e4, earlier: 300.0}).with_free(("kappa", C))
    both, alone, gains = (*BOTH, earlier), (earlier,), {"held": (0.1, ""), " ".join((*BOTH, earlier)): (0.5, ""), earlier: (0.4, "")}
    found = ended(monkeypatch, gains, {both: True, alone: True}, before=before)
    assert found.exponents == f"{' '.join(both)}: {', '.join(both)} fitted" and found.gain == 0.5
    assert ended(monkeypatch, gains, {both: False, alone: True}, before=before).gain == 0.4
    assert ended(monkeypatch, gains, {both: False, alone: False}, before=before).gain == 0.1
    for other in (before.with_free(("kappa", C, earlier)), before.with_free(("kappa",)), BASE):
        assert ended(monkeypatch, gains, {both: True, alone: True}, before=other).gain == 0.1
    assert ended(monkeypatch, gains, {both: True, alone: True}, cheap=False, before=before).gain == 0.1, "of a body a run costs too much"


def test_exponents_of_earlier_effects_are_freed_where_held_out_data_ask_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """More than any fall of the held-out error, unless the trial is refused without them."""
    earlier, C = "backstress_first.gamma", "backstress_first.C"
    before = BASE.replace(**{C: 5e4, earlier: 300.0}).with_free(("kappa", C))
    freed: dict[tuple[str, ...], bool] = {(*BOTH, earlier): True}
    gains = {"held": (0.1, ""), " ".join((*BOTH, earlier)): (0.5, "")}
    assert ended(monkeypatch, gains, freed, before=before, asked=False).gain == 0.1
    assert ended(monkeypatch, gains, freed, before=before, asked=True).gain == 0.5
    assert ended(monkeypatch, gains | {"held": (0.1, "at its bound")}, freed, before=before, asked=False).gain == 0.5


@pytest.mark.parametrize(("parts", "asked"), [((0.3, 0.3), True), ((0.5, 1.3), False), ((1.2, 1.2), False)])
def test_held_out_data_ask_by_more_than_their_uncertainty(monkeypatch: pytest.MonkeyPatch, parts: tuple[float, float], asked: bool) -> None:
    """What is predicted with the exponents freed, as a part of what is without, early and late: a fall of 3 % in all, which is one half of
    the test against the other, is none."""
    n = 120
    rows = Rows(np.zeros(n, dtype=int), np.arange(n, dtype=float), np.zeros((n, 2)), np.zeros(n, dtype=int))
    plain = np.random.default_rng(4).normal(size=n)
    ends = {"plain": plain, "freed": np.repeat(parts, n // 2) * plain}
    monkeypatch.setattr(module, "held_out_of", lambda there: ends[there.name])
    model = SimpleNamespace(noise=None)
    here: Any = SimpleNamespace(rows=rows, split=SimpleNamespace(held_out=(0, 1)), problem=SimpleNamespace(model=model))
    there: list[Any] = [SimpleNamespace(name=name, columns=SimpleNamespace(residual=end)) for name, end in ends.items()]
    assert module.asked_for(here, *there) is asked


@pytest.mark.parametrize("settles", [False, None])
def test_an_end_that_does_not_settle_is_not_taken(monkeypatch: pytest.MonkeyPatch, settles: bool | None) -> None:
    """Nor the one with exponents held where it came to, where that does not settle either."""
    gains = {"held": (0.1, ""), " ".join(BOTH): (0.4, ""), "air_drift.time": (0.5, ""), "there": (0.6, "")}
    said = ended(monkeypatch, gains, {BOTH: False, BOTH[1:]: False}, settles=settles).exponents
    assert said.startswith("held: ") and said.endswith("with them free the fit does not settle")


def test_exponents_that_do_not_settle_are_held_where_they_came_to(monkeypatch: pytest.MonkeyPatch) -> None:
    gains = {"held": (0.1, ""), " ".join(BOTH): (0.9, ""), "there": (0.3, "")}
    found = ended(monkeypatch, gains, {BOTH: False}, settles=True)
    said = "there: held at second_hardening.b = 60, air_drift.time = 1e+05, where a fit that does not settle has brought them"
    assert found.exponents.startswith(said) and found.adrift == BOTH
    found = ended(monkeypatch, gains | {"there": (0.05, "")}, {BOTH: False}, settles=True)
    assert found.exponents.startswith("held: ") and found.adrift == ()


def at_scans(
    monkeypatch: pytest.MonkeyPatch,
    ends: dict[float, tuple[float, float, bool]],
    cheap: bool = True,
    sigma: float = 0.0,
    f: dict[float, float] | None = None,
) -> tuple[list[float], list[float], Trial]:
    """Starts of a lamp that were refitted, those that were judged, and the trial that is taken: `ends` = (amplitude, gain, accepted) by
    start, their error `sigma`, their square sums `f` (rising where not given)."""
    begun: list[float] = []
    judged: list[float] = []

    def nearer(here: Any, scores: Any, chosen: Any, refit: Any) -> Any:
        start = chosen["lamp.start"]
        begun.append(start)
        return "no equilibrium" if f is not None and start not in f else (start, SimpleNamespace(f=start if f is None else f[start]))

    def judge(here: Any, fit: Any, scores: Any, end: Any, means: Any) -> Any:
        judged.append(end[0])
        size, gain, accepted = ends[end[0]]
        one = Trial(scores, replace(GOOD, gain=gain), {"lamp.absorbed": size}, {"lamp.absorbed": sigma}, 0.0, "" if accepted else "refused")
        return one, ("there", end[0]) if accepted else None

    monkeypatch.setattr(module, "nearer", nearer)
    monkeypatch.setattr(module, "ended_at", judge)
    monkeypatch.setattr(module, "at_settings", lambda here, score, scan: score)
    here = here_of(cheap=cheap)
    here.scanned, here.settings = {"lamp": tuple(({"lamp.start": s}, None) for s in ends)}, {"lamp": {"lamp.start": next(iter(ends))}}
    fit: Any = None
    means: Any = SimpleNamespace(refit=None)
    return begun, judged, tried(here, fit, of("lamp"), means)[0]


def test_an_effect_at_its_bound_is_tried_at_other_exponents(monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to one that is off it; of all ends the accepted one with the largest gain is taken. Of a body no second refit is made."""
    bound = param("lamp.absorbed").upper
    ends = {10.0: (bound, 0.9, False), 20.0: (0.995 * bound, 0.3, True), 30.0: (0.2, 0.2, True), 40.0: (0.2, 0.99, True)}
    _, judged, trial = at_scans(monkeypatch, ends)
    assert judged == [10.0, 20.0, 30.0] and trial.gain == 0.3
    begun, judged, trial = at_scans(monkeypatch, ends, cheap=False)
    assert begun == judged == [10.0] and trial.gain == 0.9
    assert at_scans(monkeypatch, {10.0: (0.3, 0.1, False), 20.0: (0.3, 0.9, True)})[1] == [10.0]
    _, judged, trial = at_scans(monkeypatch, {10.0: (0.3, 0.1, False), 20.0: (0.3, 0.9, True)}, sigma=0.2)
    assert judged == [10.0, 20.0] and trial.gain == 0.9, "nor has one a value of its own that is not away from neutral"


def test_of_coupons_the_best_fit_of_all_exponents_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    """One step ranks exponents near the optimum without the effect; the least square sum may lie in another valley. Of a body the first
    that can be run counts."""
    ends = dict.fromkeys((10.0, 20.0, 30.0, 40.0, 50.0, 60.0), (0.2, 0.5, True))
    f = {10.0: 5.0, 20.0: 4.0, 40.0: 3.0, 60.0: 1.0, 50.0: 2.0}
    begun, judged, _ = at_scans(monkeypatch, ends, f=f)
    assert begun == list(ends) and judged == [60.0]
    assert at_scans(monkeypatch, ends, f=f, sigma=1.0)[1] == [60.0, 50.0, 40.0, 20.0], "in the order of their fits, four at most"
    assert at_scans(monkeypatch, ends, cheap=False, f={30.0: 2.0, 40.0: 1.0})[:2] == ([10.0, 20.0, 30.0], [30.0])
    assert at_scans(monkeypatch, ends, cheap=False, f={60.0: 1.0})[0] == [10.0, 20.0, 30.0, 40.0]


def test_of_a_body_what_is_freed_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run costs too much to try all. What displacements show was free from the start, and was held by the refit."""
    gains = {"held": (0.4, ""), "air_drift.time": (0.1, "")}
    said = "air_drift.time: held at second_hardening.b = 60, which the data do not determine further; fitted"
    assert ended(monkeypatch, gains, {BOTH[1:]: True}, cheap=False).exponents == said


@pytest.mark.parametrize("cheap", [True, False])
def test_a_refit_of_a_body_begins_with_the_exponents_that_displacements_show(cheap: bool) -> None:
    """With them held first the same costs twice. A time of the heat balance waits for a gain; of coupons all ends are compared."""
    begun: list[tuple[bool, bool, str]] = []

    def refit(start: Parameters, label: str, **_: Any) -> Any:
        begun.append((BOTH[0] in start.free, BOTH[1] in start.free, label))
        if len(begun) == 1:
            raise NumericsError("no equilibrium")
        return start, label

    nearer(here_of(cheap=cheap), (of("second_hardening"), of("lamp")), {}, refit)
    ending = "" if cheap else EXPONENTS
    names = "second_hardening lamp"
    assert begun == [(not cheap, False, names + ending), (not cheap, False, f"{names} from 0.5{ending}")]


def worth(
    monkeypatch: pytest.MonkeyPatch, names: tuple[str, ...], needed: tuple[str, ...] = (), moves: bool = False, **tests: Proof | None
) -> Any:
    """Worth of effects that nothing else speaks against; `tests`: proofs on held-out tests."""
    monkeypatch.setattr(module, "held_out_of", lambda *_: None)
    monkeypatch.setattr(module, "compared", lambda *_: GOOD)
    monkeypatch.setattr(module, "refusal", lambda *_: "")
    monkeypatch.setattr(module, "proof_of_refit", lambda _here, _there, name: tests.get(name))
    monkeypatch.setattr(module, "still_needed", lambda _there, name: name in needed)
    monkeypatch.setattr(module, "moves_material", lambda *_: moves)
    amplitudes = tuple(effect(n).amplitude.name for n in names)
    there = here_of(BASE.replace(**dict.fromkeys(amplitudes, 0.02)))
    fit: Any = SimpleNamespace(sigma=np.full(len(names), 1e-3), names=amplitudes)
    return worth_of(here_of(), there, [of(n) for n in names], fit)


@pytest.mark.parametrize(
    ("needed", "said"),
    [
        (("ir_drift", "ir_gain"), ""),
        (("ir_gain",), "ir_drift not needed beside the other"),
        ((), "ir_drift and ir_gain not needed beside the other"),
    ],
)
def test_of_two_effects_each_has_to_be_needed(monkeypatch: pytest.MonkeyPatch, needed: tuple[str, ...], said: str) -> None:
    assert worth(monkeypatch, ("ir_drift", "ir_gain"), needed).refused == said
    assert worth(monkeypatch, ("ir_drift",)).refused == "", "one alone is judged by its proof"


def test_the_worst_held_out_test_decides_where_one_judges(monkeypatch: pytest.MonkeyPatch) -> None:
    low, high = replace(GOOD, gain=0.1), replace(GOOD, gain=0.9)
    assert worth(monkeypatch, ("ir_drift", "ir_gain"), ir_drift=high, ir_gain=low).proof is low
    assert worth(monkeypatch, ("ir_drift",), ir_drift=high).proof is high
    assert worth(monkeypatch, ("ir_drift",)).proof == GOOD


@pytest.mark.parametrize("moves", [True, False])
def test_the_proof_of_a_refit_knows_what_it_has_moved(monkeypatch: pytest.MonkeyPatch, moves: bool) -> None:
    assert worth(monkeypatch, ("ir_drift",), moves=moves).proof.moves is moves


@pytest.mark.parametrize(
    ("without", "why", "said"),
    [(0.24, "", "off"), (0.26, "", ""), (0.26, "at its bound", "off")],
    ids=["less than half", "half", "refused"],
)
def test_an_effect_has_to_keep_half_of_its_gain_with_readings_held(
    monkeypatch: pytest.MonkeyPatch, without: float, why: str, said: str
) -> None:
    """Of a gain of 0.5, where the refit drives the reading of kappa off."""
    prior = SimpleNamespace(name="kappa")
    monkeypatch.setattr(module, "contradicted", lambda *_: (prior,))
    monkeypatch.setattr(module, "in_words", lambda *_: "off")
    monkeypatch.setattr(module, "worth_of", lambda *_: SimpleNamespace(proof=replace(GOOD, gain=without), refused=why))
    begun = []

    def refit(start: Parameters, label: str, **_: Any) -> Any:
        begun.append(start)
        return start, None

    end = BASE.replace(**{RATE: 0.02, "kappa": 90.0}).with_free(("kappa", "c0", RATE))
    means: Any = SimpleNamespace(refit=refit, at_end=lambda *_: None)
    here = here_of(model=SimpleNamespace(priors=()))
    found, words = on_readings(here, [of("ir_drift")], end, GOOD, means)
    assert found == said and words.startswith("with kappa held held-out error falls")
    (start,) = begun
    assert start["kappa"] == 120.0 and start.free == ("c0", RATE), "the reading is held where it was"


def test_an_effect_whose_own_param_no_reading_explains_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "contradicted", lambda *_: (SimpleNamespace(name=RATE),))
    monkeypatch.setattr(module, "in_words", lambda *_: "off")
    means: Any = SimpleNamespace(refit=failing)
    here = here_of(model=SimpleNamespace(priors=()))
    assert on_readings(here, [of("ir_drift")], BASE.replace(**{RATE: 0.02}), GOOD, means) == ("off", "")


@pytest.mark.parametrize(("gain", "apart"), [(0.021, True), (0.019, False)])
def test_refits_are_told_apart_by_two_standard_errors(monkeypatch: pytest.MonkeyPatch, gain: float, apart: bool) -> None:
    """The one of the larger held-out error is that without."""
    one, other = here_of(), here_of()
    for ended in (one, other):
        ended.rows = Rows(np.zeros(3, dtype=int), np.arange(3.0), np.zeros((3, 2)), np.zeros(3, dtype=int))
        ended.columns.residual = np.ones(3)
    error = {id(one): np.ones(3), id(other): np.zeros(3)}

    def compare(before: np.ndarray, after: np.ndarray, *_: Any) -> Proof:
        return replace(GOOD, gain=gain if before.sum() > after.sum() else -gain, sigma=0.01)

    monkeypatch.setattr(module, "held_out_of", lambda t: error[id(t)])
    monkeypatch.setattr(module, "compared", compare)
    assert discriminated(one, other) is apart and discriminated(other, one) is apart
    assert surely_better(other, one) is apart and not surely_better(one, other)
    assert surely_better(other, one, 2.2) is False and surely_better(other, one, 1.8) is True


@pytest.mark.parametrize("unexplained", [1.0, 6.0])
def test_a_channel_that_neither_explains_tells_nothing_of_which_is_right(unexplained: float) -> None:
    """One of two refits leaves a tenth more in the displacements; the temperatures hold what is missing besides, and differ by chance."""
    n = 4000
    draw = np.random.default_rng(2)
    channel = np.repeat([0, 1], n)
    time = np.tile(np.linspace(0.0, 100.0, n), 2)
    rows = Rows(channel, time, np.zeros((2 * n, 2)), np.zeros(2 * n, dtype=int))
    noise, (slow, chance) = draw.normal(size=2 * n), np.repeat(draw.normal(size=(2, n // 40)), 40, axis=1)
    temperatures = unexplained * np.where(unexplained > 1.0, slow, noise[n:])
    split = Split((time < 50.0, time >= 50.0), (np.zeros(2 * n, dtype=bool),) * 2, "halves")

    def ended(more: float, by_chance: float) -> Any:
        left = np.concatenate([noise[:n] + more * np.sin(time[:n]), temperatures * (1.0 + by_chance * chance)])
        model = LinearModel(left, np.zeros((2 * n, 0)))
        return SimpleNamespace(rows=rows, split=split, problem=SimpleNamespace(model=model), columns=SimpleNamespace(residual=left))

    right, other = ended(0.0, 0.05), ended(0.45, -0.05)
    assert discriminated(right, other) and discriminated(other, right)
    assert not discriminated(right, ended(0.0, -0.05)), "the same"


def test_a_channel_that_leaves_less_than_its_noise_counts_no_more_for_it() -> None:
    """Displacements are noise in both refits, and differ by chance; of temperatures both leave a hundredth of the noise, one less."""
    n = 4000
    draw = np.random.default_rng(4)
    channel, time = np.repeat([0, 1], n), np.tile(np.linspace(0.0, 100.0, n), 2)
    rows = Rows(channel, time, np.zeros((2 * n, 2)), np.zeros(2 * n, dtype=int))
    split = Split((time < 50.0, time >= 50.0), (np.zeros(2 * n, dtype=bool),) * 2, "halves")
    noise, chance = draw.normal(size=2 * n), np.repeat(draw.normal(size=n // 40), 40)

    def ended(by_chance: float, temperatures: float) -> Any:
        left = np.concatenate([noise[:n] * (1.0 + by_chance * chance), temperatures * noise[n:]])
        model = LinearModel(left, np.zeros((2 * n, 0)))
        return SimpleNamespace(rows=rows, split=split, problem=SimpleNamespace(model=model), columns=SimpleNamespace(residual=left))

    assert not discriminated(ended(0.05, 0.01), ended(-0.05, 0.012))
    assert discriminated(ended(0.05, 1.0), ended(-0.05, 1.2)), "as it does where they are of the size of the noise"


def test_runs_for_the_values_of_exponents_show_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """One for each value, also where the model fails with it: on a full mesh they take minutes before the first refit."""
    shown: list[Any] = []

    @contextmanager
    def progress(words: str, total: float) -> Any:
        shown.append((words, total))
        yield shown.append

    def columns_of(case: Any, own: Any, values: dict[str, float]) -> Any:
        if values["lamp.start"] == 20.0:
            raise NumericsError("no equilibrium")
        return values["lamp.start"]

    values = [{"lamp.start": s} for s in (10.0, 20.0, 30.0)]
    for where in (module, trace):
        monkeypatch.setattr(where, "scans", lambda *_: values)
    monkeypatch.setattr(module, "progress", progress)
    monkeypatch.setattr(trace, "columns_of", columns_of)
    monkeypatch.setattr(trace, "drop_of", lambda columns, names, block: block)
    monkeypatch.setattr(module, "at_settings", lambda here, score, scan: score)
    begun: list[Any] = []
    monkeypatch.setattr(module, "nearer", lambda here, scores, chosen, refit: begun.append(chosen) or "no equilibrium")
    here = here_of(cheap=False)
    here.scanned, here.settings, here.problem = {}, {}, SimpleNamespace(dormant={})
    fit: Any = None
    means: Any = SimpleNamespace(refit=None)
    tried(here, fit, of("lamp"), means)
    assert shown == [("exponents of lamp", 3), 1, 1, 1] and begun == [values[2], values[0]]
