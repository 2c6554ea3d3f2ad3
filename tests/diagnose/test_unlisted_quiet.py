"""What no block of a body shows: something small and everywhere, of which held-out data ask for a term."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from refits import fitted, refitting
from strip import SIGMA, numerical, strip_case

from thermofit.diagnose import unlisted as module
from thermofit.diagnose import unlisted_loop as loop
from thermofit.diagnose.held_out import Rows
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.quiet import quiet
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.unlisted import standing, structured
from thermofit.diagnose.unlisted_structure import Structure, structures

AMOUNT = 0.3 * SIGMA
N_STRIP = len(numerical())


def wandering(seed: int, amount: float = AMOUNT) -> Traced:
    """A camera whose offset goes to and fro twice, by less than a third of the noise of a pixel."""
    return looped(seed, amount).last


def looped(seed: int, amount: float = AMOUNT) -> Closed:
    """The end of a loop that has accepted nothing on it."""
    case, fit = fitted(strip_case(seed, offset=lambda t: amount * np.sin(2.0 * np.pi * t / 60.0)))
    here = traced(case, numerical())
    return Closed((), here, here, fit, (), (), refitting(case.model), numerical())


@pytest.mark.parametrize("seed", [4, 5])
def test_what_no_block_shows_is_told_where_held_out_data_ask_for_it(seed: int) -> None:
    closed = looped(seed)
    assert standing(closed.last, numerical()) == []
    _, found = loop.ended(closed, closed.refit, numerical(), "auto")
    assert found is not None and found.field is not None and found.field.basis.kind == "offset"
    first, second, third, fourth = np.interp([15.0, 45.0, 75.0, 105.0], found.field.basis.grid.time, found.field.values.ravel())
    assert 0.25 * (first - second + third - fourth) == pytest.approx(AMOUNT, rel=0.45), "smoothed"


@pytest.mark.parametrize("seed", [20, 21, 22])
def test_nothing_is_asked_for_where_nothing_is_missing(seed: int) -> None:
    assert structured(wandering(seed, 0.0), numerical()) == []


def test_it_is_asked_for_by_held_out_data_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    here = wandering(4)
    (found,) = structured(here, numerical())
    assert found.blocks.channel == "theta" and found.stands_out
    monkeypatch.setattr(module, "believed", lambda *_: False)
    assert structured(here, numerical()) == []


@pytest.mark.parametrize(
    ("errors", "gain", "moved", "told"),
    [
        *((3.9, 0.04, (0.0, 0.0), False), (4.1, 0.04, (0.0, 0.0), True), (20.0, 0.031, (0.0, 0.0), True)),
        *((20.0, 0.029, (0.0, 0.0), False), (20.0, 0.029, (5.1, 0.021), True), (3.9, 0.029, (5.1, 0.021), False)),
        *((20.0, 0.029, (4.9, 0.021), False), (20.0, 0.029, (5.1, 0.019), False), (20.0, 0.004, (5.1, 0.021), False)),
    ],
)
def test_held_out_data_ask_for_it_by_four_standard_errors_and_three_per_cent(
    monkeypatch: pytest.MonkeyPatch, errors: float, gain: float, moved: tuple[float, float], told: bool
) -> None:
    """Three, and half a per cent, are enough for a term of a channel in which blocks stand out. Here some kind of many has nearly four by
    chance, and of many rows any small error of a model would be significant. Less than three per cent is worth it where a parameter moves
    by five of its standard errors, and by a fiftieth of its value."""
    here = wandering(4)
    known = module.everywhere_alike(here, here, cast(Any, SimpleNamespace(blocks=SimpleNamespace(channel="theta"))), {"theta": ("offset",)})
    assert known is not None
    step, sigma = np.zeros(len(known.term.step)), np.full(len(known.term.step), 1e6)
    first = here.case.parameters[here.case.parameters.free[0]]
    if moved[0] > 0.0:
        step[0], sigma[0] = -moved[1] * first, moved[1] * first / moved[0]
    proof = replace(known.term.proof, gain=gain, sigma=gain / errors)
    term = replace(known.term, proof=proof, step=step, uncertainty=sigma)
    monkeypatch.setattr(module, "everywhere_alike", lambda *_: replace(known, term=term))
    monkeypatch.setattr(module, "broad_basis", lambda *_: None)
    assert bool(structured(here, numerical())) is told


def test_histories_of_few_hats_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many as a coupon has. What grows along the load is none: it is told in the stead of another term alone."""
    asked: list[Any] = []
    monkeypatch.setattr(module, "everywhere_alike", lambda *of: asked.append(of[3:]))
    monkeypatch.setattr(module, "broad_basis", lambda *_: None)
    missing = SimpleNamespace(of_surface={"theta": ("flux", "jaws")}, of_instruments={"theta": ("offset", "gradient"), "u": ("strain",)})
    here: Any = SimpleNamespace(case=SimpleNamespace(model=SimpleNamespace(missing=missing)))
    assert module.asked_for(here, cast(Any, None)) is None
    assert asked == [({"theta": ("flux", "jaws")}, 48), ({"theta": ("offset",), "u": ("strain",)}, 48)]


@pytest.mark.parametrize("seed", [20, 21, 22])
def test_quiet_histories_are_told_from_an_error_of_the_mesh(seed: int) -> None:
    """A finer strip looks like an offset of the camera; beside the error of the mesh none is likely. A camera that wanders is, beside that
    error too."""
    for amount, mesh, likely in (
        (0.0, np.zeros((N_STRIP, 0)), True),
        (0.0, numerical()[:, None], False),
        (AMOUNT, numerical()[:, None], True),
    ):
        here = wandering(seed, amount)
        (one,) = structures(here.case, here.rows, here.problem.model.left, None)
        found = quiet(here.problem.model, mesh, here.case, one)
        assert found is not None and set(found.likelihood) == {"flux", "offset", "heat"}
        assert (found.likelihood["offset"] > 0.9) is likely and (sum(found.likelihood.values()) < 0.3) is not likely, found.likelihood
        assert found.covariance.shape == (2, 2)


def test_quiet_histories_have_no_more_hats_than_a_coupon_has() -> None:
    here = wandering(4)
    (one,) = structures(here.case, here.rows, here.problem.model.left, None)
    assert {kind: hat.columns.shape[1] for kind, hat in module.histories(here.case, one, most=7).items()} == {"flux": 7, "offset": 7}
    assert all(hat.columns.shape[1] > 48 for hat in module.histories(here.case, one).values())


def test_what_no_block_shows_is_asked_for_in_the_stead_of_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the camera may add is asked for in the channel in which accepted effects leave something that no block shows."""
    here, asked = wandering(4), []
    assert standing(here, numerical()) == []
    monkeypatch.setattr(loop, "broad_basis", lambda *_: None)
    monkeypatch.setattr(loop, "camera_bases", lambda _, structure: asked.append(structure.blocks.channel) or [])
    closed: Any = SimpleNamespace(last=here, first=here, accepted=("ir_drift",))
    assert loop.in_their_stead(closed, structured(closed.last, numerical())) == () and asked == ["theta"]


def test_what_half_of_the_error_of_the_mesh_would_make_is_not_told() -> None:
    assert structured(wandering(4), 5.0 * numerical()) == []


def weighted(weight: np.ndarray, residual: np.ndarray, noise: Any = None) -> Structure:
    """The structure of a body that is seen at two points at 40 times, by rows and by a weight, whichever stands out more."""
    time, point = np.repeat(np.arange(40), 2), np.tile([0, 1], 40)
    rows = np.stack([time, point, np.zeros(80, dtype=int)], axis=1)
    comparison = SimpleNamespace(n=80, rows=rows, channel="dtheta", noise=noise)
    case: Any = SimpleNamespace(
        model=SimpleNamespace(comparisons=(comparison,), segments=None, priors=()), cheap=False, channels=("dtheta",)
    )
    xy = np.stack([np.zeros(80), 20.0 * point], axis=1)
    where = Rows(np.zeros(80, dtype=int), time.astype(float), xy, np.zeros(80, dtype=int))
    (found,) = structures(cast(Any, case), where, residual, None, {0: (weight,)})
    return found


def test_what_is_added_counts_at_all_places_of_a_time_together() -> None:
    """One point warmer and one colder by as much, over the noise of both: by the weight its sums are those of all rows, squared over their
    number, in each of sixteen blocks of time."""
    sign = np.tile([1.0, -1.0], 40)
    residual = 3.0 * sign + np.random.default_rng(3).normal(size=80)
    found = weighted(sign, residual)
    assert len(found.blocks.count) == 16 and found.stands_out
    sums = np.bincount(found.blocks.block, sign * residual)
    assert found.excess + found.blocks.noise.sum() == pytest.approx(float(np.sum(sums**2 / found.blocks.count)))


def test_noise_that_all_times_share_counts_by_the_weight() -> None:
    """An error of the reference that both points have in common is none of their difference."""
    sign, residual = np.tile([1.0, -1.0], 40), 3.0 * np.tile([1.0, -1.0], 40) + np.random.default_rng(3).normal(size=80)

    def common(v: np.ndarray) -> np.ndarray:
        return np.asarray(v + 0.5 * np.ones((80, 80)) @ v)

    alone, beside = weighted(sign, residual), weighted(sign, residual, common)
    assert beside.blocks.noise == pytest.approx(alone.blocks.noise)


def test_what_shows_nothing_is_no_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jaws that warm up behind a contact that conducts nothing: neither asked for, nor weighed beside another term."""
    here = wandering(4)
    (found,) = structured(here, numerical())
    channel: Any = SimpleNamespace(blocks=SimpleNamespace(channel="theta"))
    known, shows = module.everywhere_alike(here, here, channel, {"theta": ("offset",)}), module.basis
    assert known is not None
    (beside,) = module.histories(here.case, found, known.term)

    def nothing(case: Any, structure: Any, kind: str, *of: Any) -> Any:
        hat = shows(case, structure, kind, *of)
        return replace(hat, columns=0.0 * hat.columns) if kind in ("offset", beside) else hat

    monkeypatch.setattr(module, "basis", nothing)
    assert module.everywhere_alike(here, here, channel, {"theta": ("offset",)}) is None
    assert module.histories(here.case, found, known.term) == {}
