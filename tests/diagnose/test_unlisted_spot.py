"""A heat that nobody lists and that has a place, as one spot beside which parameters are told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from refits import fitted
from said_progress import said_progress
from scipy.stats import norm
from strip import BASE, MODEL, Source, strip_case

from thermofit.diagnose import unlisted as module
from thermofit.diagnose.beside_source import Spot, spot_of
from thermofit.diagnose.held_out import Rows, Split
from thermofit.diagnose.trace import Traced, traced
from thermofit.diagnose.unlisted import LEAVES, UNSETTLED, Unlisted, as_spot, at_parameters, beside_spot, structured, unlisted
from thermofit.diagnose.unlisted_field import Basis, MissingField, best_beside, field_of, likeliest, roughness, with_parameters
from thermofit.diagnose.unlisted_spot import nearest, travels
from thermofit.experiment.missing import Grid, hats
from thermofit.fit.linear_model import LinearModel

TIME, HEIGHT = np.linspace(0.0, 100.0, 21), np.linspace(-30.0, 30.0, 61)
T, Y = (v.ravel() for v in np.meshgrid(TIME, HEIGHT, indexing="ij"))
GRID = Grid(TIME, np.zeros(len(TIME), dtype=int), np.zeros(1), np.zeros(1), spread=4.0)


def hats_at(grid: Grid) -> Basis:
    """Hats of a spot that is seen as it is, in units of the noise."""
    chosen = np.arange(grid.size)
    columns = hats(grid.time, T) * norm.pdf(Y[:, None], grid.heights, grid.spread) * 50.0
    return Basis("heat", "mW/mm^3", grid, chosen, np.arange(len(T)), columns, roughness(grid, chosen))


def shown_at(grid: Grid, amount: np.ndarray) -> np.ndarray:
    return hats_at(grid).columns @ amount


def seen(middle: float, spread: float, velocity: float = 0.0) -> tuple[LinearModel, Rows, Split]:
    """What a fit with a level and a slope leaves of a spot whose power comes and goes; it is at its middle at 50 s."""
    truth = 2.0 * (1.0 + np.sin(T / 15.0)) * norm.pdf(Y, middle + velocity * (T - 50.0), spread) * 50.0
    residual = -truth + np.random.default_rng(3).standard_normal(len(T))
    rows = Rows(np.zeros(len(T), dtype=int), T, np.stack([0.0 * Y, Y], axis=1), np.zeros(len(T), dtype=int))
    fifths = tuple(np.arange(len(T)) // 5 % 5 == k for k in range(5))
    return LinearModel(residual, np.stack([np.ones_like(T), Y / 30.0], axis=1)), rows, Split(fifths, fifths, "fifths")


def spot_from(
    model: LinearModel,
    hats: Callable[[Grid], Basis],
    shown: Callable[[Grid, np.ndarray], np.ndarray],
    begin: Grid,
    data: Any,
    least: float,
    steps: int = 4,
) -> MissingField:
    """The field of the nearest spot where the parameters have taken their steps beside it, so that it goes with these."""
    for _ in range(steps):
        found = field_of(model, nearest(model.residual, hats, shown, hats(begin), weight=1e-3, least=least), *data, 1e-3)
        model, begin = replace(model, residual=model.residual + model.columns @ found.step), found.basis.grid
    return found


@pytest.mark.parametrize(("y", "spread"), [(0.0, 4.0), (12.0, 1.0), (-12.0, 15.0)])
def test_middle_and_spread_are_found(y: float, spread: float) -> None:
    """From beside it, from one of a third of its size, and from one that covers nearly all."""
    model, *data = seen(7.3, 3.0)
    found = spot_from(model, hats_at, shown_at, replace(GRID, y=np.array([y]), spread=spread), data, 0.5)
    grid, m = found.basis.grid, GRID.size
    assert grid.y[0] == pytest.approx(7.3, abs=0.1) and grid.spread == pytest.approx(3.0, rel=0.02)
    assert found.basis.columns.shape[1] == m + 2 and np.all(np.abs(found.q[m:]) < 0.2 * np.sqrt(np.diag(found.posterior)[m:]))


@pytest.mark.parametrize(("y", "velocity", "spread"), [(0.0, 0.1, 8.0), (6.0, 0.5, 2.0), (4.0, 0.0, 4.0)])
def test_velocity_is_found(y: float, velocity: float, spread: float) -> None:
    """From a slower one, a faster one and from rest; with the middle, which lies anywhere on its way, and the spread."""
    model, *data = seen(4.0, 3.0, 0.31)
    begin = replace(GRID, y=np.array([y]), spread=spread, along=velocity * (TIME - 40.0))
    found = spot_from(model, hats_at, shown_at, begin, data, 0.5)
    grid, m = found.basis.grid, GRID.size
    assert grid.heights == pytest.approx(4.0 + 0.31 * (TIME - 50.0), abs=0.2) and grid.spread == pytest.approx(3.0, rel=0.03)
    assert found.basis.columns.shape[1] == m + 3 and np.all(np.abs(found.q[m:]) < 0.2 * np.sqrt(np.diag(found.posterior)[m:]))
    told = spot_of(found)
    assert told.velocity is not None and told.time is not None
    assert abs(told.velocity[0] - 0.31) < 3.0 * told.velocity[1] < 0.02
    assert told.y == pytest.approx(4.0 + 0.31 * (told.time - 50.0), abs=0.1) and told.spread == grid.spread
    assert spot_of(replace(found, q=found.q[:-1])).spread is None
    beside = abs(np.corrcoef(found.basis.columns[:, m : m + 2].T)[0, 1])
    assert beside < 0.2, "the velocity is about the middle of its power: it says nothing of where that is"


@pytest.mark.parametrize(("velocity", "off"), [(0.31, 0.0), (-0.2, 0.0), (0.31, 0.6), (0.02, 0.0)])
def test_hats_over_the_face_show_that_a_heat_travels(velocity: float, off: float) -> None:
    """Its middle at every time, by the power of one sign; less than it reaches along the load is no way. What is outside of its window says
    nothing."""
    time, y = np.linspace(0.0, 100.0, 13), np.linspace(-20.0, 20.0, 9)
    middle = 4.0 + velocity * (time - 50.0)
    power = -np.exp(-0.5 * ((y - middle[:, None]) / 4.0) ** 2) * np.ones((13, 1)) + off * (y < -15.0)
    power[time > 80.0] = np.where(y > 15.0, -5.0, 0.0)
    grid = Grid(time, np.zeros(13, dtype=int), np.array([-5.0, 5.0]), y)
    term: Any = SimpleNamespace(basis=SimpleNamespace(grid=grid), values=np.repeat(power[:, :, None, None], 2, axis=2))
    place: Any = SimpleNamespace(when=(0.0, 80.0), extent=(3.0, 5.0))
    line = travels(term, place)
    if abs(velocity) * 80.0 < 5.0:
        assert line is None
        return
    assert line is not None and line[1] == pytest.approx(velocity, abs=0.02)
    assert line[0] == pytest.approx(4.0 + velocity * (line[2] - 50.0), abs=0.3)
    place.when = (30.0, 30.0)
    assert travels(term, place) is None, "nor has one knot"


def on_a_mesh(grid: Grid) -> Basis:
    """The same on a mesh that shows a spot no narrower than 3 mm, and a wide one beside where it is."""
    shown = replace(grid, y=grid.y + grid.spread**2 / 3.0, spread=float(np.hypot(grid.spread, 3.0)))
    return replace(hats_at(shown), grid=grid)


def shown_on_a_mesh(grid: Grid, amount: np.ndarray) -> np.ndarray:
    return on_a_mesh(grid).columns @ amount


@pytest.mark.parametrize("spread", [0.35, 0.45, 0.6])
@pytest.mark.parametrize("truth", [2.5, 2.9])
def test_the_middle_is_found_where_the_spread_is_not_shown(truth: float, spread: float) -> None:
    """A spot that is narrower than the mesh shows any asks for a step of the spread without end. That says nothing of the middle."""
    model, *data = seen(7.3, truth)
    found = spot_from(model, on_a_mesh, shown_on_a_mesh, replace(GRID, y=np.array([7.3]), spread=spread), data, 0.3)
    m = GRID.size
    assert found.basis.grid.spread == pytest.approx(0.3) and found.basis.columns.shape[1] == m + 1
    assert np.abs(found.q[m:]) < 0.2 * np.sqrt(np.diag(found.posterior)[m:])
    best = min(
        np.linspace(7.0, 7.5, 51), key=lambda y: with_parameters(model, on_a_mesh(replace(GRID, y=np.array([y]), spread=0.3)), 1e-3)[2]
    )
    assert found.basis.grid.y[0] == pytest.approx(best, abs=0.02)


def test_a_search_that_was_cut_short_has_not_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """A spread that would fall by more than one step lets it is fitted all the same: its step says how far off it is."""
    monkeypatch.setattr("thermofit.diagnose.unlisted_spot.MOST", 0)
    model, *data = seen(7.3, 1.5)
    found = spot_from(model, hats_at, shown_at, replace(GRID, y=np.array([7.3]), spread=20.0), data, 0.1, steps=1)
    m = GRID.size
    assert found.basis.columns.shape[1] == m + 2 and found.q[-1] < -1.0 and found.basis.grid.spread == 20.0


def test_a_place_goes_with_parameters_that_stay() -> None:
    """Where a level is off by 3 times the noise, no place beside the one that is found leaves less with that level. Where the level has
    stepped back another one is the best."""
    model, *data = seen(7.3, 3.0)
    off = replace(model, residual=model.residual + 3.0 * model.columns[:, 0])
    grid = nearest(off.residual, hats_at, shown_at, hats_at(GRID), weight=1e-3, least=0.5).grid

    def left(one: Grid) -> float:
        return best_beside(off.residual, hats_at(one), 1e-3)[1]

    for y, spread in ((0.05, 1.0), (-0.05, 1.0), (0.0, 1.01), (0.0, 0.99)):
        assert left(replace(grid, y=grid.y + y, spread=grid.spread * spread)) > left(grid)
    assert left(spot_from(off, hats_at, shown_at, GRID, data, 0.5).basis.grid) > left(grid) + 1.0


def test_a_spot_grows_again_from_the_least() -> None:
    """Where it began, or where errors of the mesh had held it."""
    model, *data = seen(7.3, 3.0)
    found = spot_from(model, hats_at, shown_at, replace(GRID, y=np.array([6.9]), spread=0.5), data, 0.5)
    assert found.basis.grid.spread == pytest.approx(3.0, rel=0.02) and found.basis.columns.shape[1] == GRID.size + 2


def test_what_nobody_sees_has_no_place() -> None:
    """It stays where it is."""
    model, *data = seen(7.3, 3.0)

    def unseen(grid: Grid) -> Basis:
        hat = hats_at(grid)
        return replace(hat, columns=0.0 * hat.columns)

    found = spot_from(model, unseen, lambda _, amount: np.zeros(len(T)), replace(GRID, y=np.array([6.9])), data, 0.5)
    assert found.basis.grid.y[0] == 6.9 and found.basis.grid.spread == 4.0 and np.all(found.q == 0.0)


def test_a_search_knows_what_the_field_knows() -> None:
    """Coefficients, covariance and sum of squares of hats beside parameters are those of the field without held-out data. Beside parameters
    that stay they are the least as well."""
    model, *data = seen(7.3, 3.0)
    hat, weight = hats_at(replace(GRID, y=np.array([5.0]))), 0.7
    field = field_of(model, hat, *data, weight)
    q, covariance, square = with_parameters(model, hat, weight)
    assert q == pytest.approx(field.q, abs=1e-6) and np.allclose(covariance, field.posterior, rtol=1e-5, atol=1e-9)
    assert square == pytest.approx(float(field.residual @ field.residual + weight * field.q @ hat.rough @ field.q))
    staying, left = best_beside(model.residual, hat, weight)

    def left_by(these: np.ndarray) -> float:
        r = model.residual + hat.columns @ these
        return float(r @ r + weight * these @ hat.rough @ these)

    assert left == pytest.approx(left_by(staying)) and left > square
    for k in range(0, len(q), 5):
        aside = 0.05 * np.eye(len(q))[k]
        assert min(left_by(staying + aside), left_by(staying - aside)) > left


def test_a_spot_is_no_narrower_than_the_mesh_shows() -> None:
    """Of one that would be, the spread is held at the least, and not fitted."""
    model, *data = seen(7.3, 0.8)
    found = spot_from(model, hats_at, shown_at, GRID, data, 2.0)
    assert found.basis.grid.spread == 2.0 and found.basis.grid.y[0] == pytest.approx(7.3, abs=0.5)
    assert found.basis.columns.shape[1] == GRID.size + 1


def across(power: float, y0: float, size: float) -> Source:
    """A source as wide as the strip about a height, of that power in mW/mm^2 of its cross-section, that comes and goes."""

    def source(x: np.ndarray, y: np.ndarray, time: float) -> np.ndarray:
        density = np.exp(-0.5 * ((y - y0) / size) ** 2) / (np.sqrt(2.0 * np.pi) * size)
        return np.asarray(power * (1.0 + np.sin(2.0 * np.pi * time / 55.0)) * density + 0.0 * x)

    return source


def told(*sources: Source) -> tuple[Traced, Unlisted]:
    """A strip of the model's own cells, so that the mesh has no errors, with these sources at its optimum without them, and what is told as
    unlisted."""
    case = fitted(strip_case(3, lambda x, y, t: sum((s(x, y, t) for s in sources), 0.0 * x), lab=MODEL))[0]
    sharp: Any = SimpleNamespace(model=case.model, doubts={})
    here = traced(replace(case, refined_at=lambda parameters, beside=None: sharp))
    found = unlisted(here, structured(here, None), [])
    assert found is not None and found.field is not None and found.field.basis.grid.places > 1
    return here, found


@pytest.fixture(scope="module")
def one() -> tuple[Traced, Unlisted, Unlisted]:
    """A strip with one spot, what is told of it, and that as one spot."""
    here, found = told(across(0.8, 8.0, 4.0))
    spot, why = as_spot(here, found)
    assert spot is not None and why == ""
    return here, found, spot


def test_a_place_that_is_moved_a_little_is_asked_for_its_coefficients_alone(
    one: tuple[Traced, Unlisted, Unlisted], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All hats are asked where the spot is and where it goes. A difference by its middle or its
    spread costs one answer, not one for each hat."""
    here, _, spot = one
    assert spot.field is not None and here.case.model.missing is not None
    of, asked = type(here.case.model.missing), {True: 0, False: 0}
    answers = of.answers

    def counted(self: Any, kind: str, parameters: Any, grid: Grid, chosen: np.ndarray, amount: np.ndarray | None = None) -> Any:
        asked[amount is not None] += 1
        every = answers(self, kind, parameters, grid, chosen)
        return every if amount is None else {name: (value @ amount)[..., None] for name, value in every.items()}

    monkeypatch.setattr(of, "answers", counted)
    monkeypatch.setattr(of, "slopes", lambda *_: {})
    basis = spot.field.basis
    moved = replace(spot.field, basis=replace(basis, grid=replace(basis.grid, y=np.array([7.0]))))
    found = at_parameters(here, replace(here.case, parameters=spot.parameters), spot.structure, moved)
    assert found.basis.grid.y[0] == pytest.approx(basis.grid.y[0], abs=0.2)
    steps = asked[True] // 2 - 1  # a middle and a spread wherever it is, at its end as well
    assert steps >= 1 and asked == {True: 2 * (steps + 1), False: 1 + steps}


def test_a_search_for_what_nobody_lists_says_what_it_asks(one: tuple[Traced, Unlisted, Unlisted], monkeypatch: pytest.MonkeyPatch) -> None:
    """Each question takes as long as an evaluation of a fit."""
    here, _, spot = one
    said = said_progress(monkeypatch, module.__name__)
    monkeypatch.setattr(module, "told", lambda *_: spot)
    monkeypatch.setattr(module, "or_rival", lambda *_: spot)
    assert unlisted(here, [spot.structure], []) is spot
    asked = ["parameters that it has not driven off", "a term with a place", *2 * ["a term that is the same everywhere"]]
    assert said == [("unlisted terms", f"theta: {words}", None) for words in asked]


def test_parameters_that_settle_beside_a_spot_say_how_far_they_are(
    one: tuple[Traced, Unlisted, Unlisted], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each step takes minutes on a body: all that were tried are shown, and stand in the log."""
    here, _, spot = one
    assert spot.field is not None
    said = said_progress(monkeypatch, module.__name__)
    begin = replace(here, case=replace(here.case, parameters=spot.parameters))
    module.settled(begin, spot.structure, spot.field)
    assert 1 <= len(said) <= module.MOST_STEPS
    for words, note, told in said:
        assert words == "parameters beside the missing heat source" and note.startswith("sum of squares") and "fallen" in told


def test_parameters_beside_a_spot_come_back_though_it_drove_them_off(one: tuple[Traced, Unlisted, Unlisted]) -> None:
    """Within three standard errors, of which the optimum without it is many off; where it is within half a millimetre, its spread and its
    power over time within a tenth."""
    here, _, spot = one
    assert spot.field is not None
    names, sigma = spot.parameters.free, spot.field.uncertainty
    off = [(spot.parameters[n] - BASE[n]) / s for n, s in zip(names, sigma, strict=True)]
    assert np.abs(off).max() < 3.0, dict(zip(names, off, strict=True))
    assert max(abs(here.case.parameters[n] - BASE[n]) / s for n, s in zip(names, sigma, strict=True)) > 10.0
    grid, power = spot.field.basis.grid, spot.field.values[:, 0, 0, 0]
    assert grid.y[0] == pytest.approx(8.0, abs=0.5) and grid.spread == pytest.approx(4.0, rel=0.1)
    inside = (grid.time > 10.0) & (grid.time < 110.0)
    truth = 0.8 * (1.0 + np.sin(2.0 * np.pi * grid.time / 55.0))
    assert np.sqrt(np.mean((power - truth)[inside] ** 2)) < 0.1 * truth.max()
    assert sigma[0] < 0.1 * BASE[names[0]], "and they are known"


def test_a_field_is_told_beside_a_spot_that_is_known(one: tuple[Traced, Unlisted, Unlisted], monkeypatch: pytest.MonkeyPatch) -> None:
    """By the hats with which it was found, where parameters beside the spot are: no step is left, but at the optimum without it. It is not
    told of a channel that holds no structure, where held-out data do not ask for it."""
    here, found, spot = one
    hold = structured(here, None)
    term = beside_spot(here, hold, found, spot)
    assert term is not None and term.field is not None and found.field is not None and term.spot is spot and term.place is not None
    assert term.parameters == spot.parameters and term.structure is hold[0] and term.channel == "theta" and term.others == ()
    assert np.array_equal(term.field.basis.chosen, found.field.basis.chosen) and term.place.centroid[1] == pytest.approx(8.0, abs=0.5)
    assert np.abs(term.field.step / term.field.uncertainty).max() < 1.0
    driven = beside_spot(here, hold, found, replace(spot, parameters=here.case.parameters))
    assert driven is not None and driven.field is not None and np.abs(driven.field.step / driven.field.uncertainty).max() > 3.0
    assert term.field.before == pytest.approx(here.problem.model.predicted(here.split.folds), nan_ok=True)
    assert beside_spot(here, [], found, spot) is None and beside_spot(here, hold, replace(found, field=None), spot) is None
    monkeypatch.setattr(module, "believed", lambda *_: False)
    assert beside_spot(here, hold, found, spot) is None


def test_a_spot_is_found_from_where_it_is_not(one: tuple[Traced, Unlisted, Unlisted]) -> None:
    """From 6 mm beside it and three times as wide; it moves no way along which the squares rise."""
    here, found, spot = one
    assert spot.field is not None
    begin = replace(spot.field, basis=replace(spot.field.basis, grid=replace(spot.field.basis.grid, y=np.array([14.0]), spread=12.0)))
    there = replace(here.case, parameters=spot.parameters)
    again, near = (at_parameters(here, there, found.structure, term) for term in (begin, spot.field))
    assert again.basis.grid.y[0] == pytest.approx(spot.field.basis.grid.y[0], abs=0.05)
    assert again.basis.grid.spread == pytest.approx(spot.field.basis.grid.spread, rel=0.03)
    assert again.uncertainty == pytest.approx(near.uncertainty, rel=0.002), "what parameters change of it is told where it is"
    assert again.step / near.uncertainty == pytest.approx(near.step / near.uncertainty, abs=0.005)


def test_a_step_is_judged_by_what_a_spot_leaves_where_it_is(
    one: tuple[Traced, Unlisted, Unlisted], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not by what its middle and its spread would leave if they went on, which is of first order. The place is sought with the lambda of
    the term at hand, so that it and the step are judged by one sum of squares; with the next term comes the likeliest one of its hats."""
    here, _, spot = one
    assert spot.field is not None and here.case.model.missing is not None
    weight, there = 7.0 * spot.field.weight, replace(here.case, parameters=spot.parameters)
    far = replace(spot.field.basis, grid=replace(spot.field.basis.grid, y=np.array([14.0]), spread=12.0))
    monkeypatch.setattr("thermofit.diagnose.unlisted_spot.MOST", 0)
    begin = replace(at_parameters(here, there, spot.structure, replace(spot.field, basis=far)), weight=weight)
    said: list[float] = []
    still = replace(begin, step=np.zeros_like(begin.step))
    low, high = (np.full(len(spot.parameters.free), end) for end in (-np.inf, np.inf))

    def falling() -> MissingField:
        then, *_ = module.falling(
            here, spot.structure, still, spot.parameters, (low, high), 0, 1.0, lambda n=1.0, note="", told=None: said.append(told["fallen"])
        )
        assert then is not None
        return then

    falling()
    assert said.pop() == pytest.approx(0.0, abs=1e-6), "a place that may not move has not gone on"
    monkeypatch.undo()
    then = falling()
    m, bare = len(far.chosen), still.bare
    squares = [best_beside(bare, replace(b, columns=b.columns[:, :m], rough=b.rough[:m, :m]), weight)[1] for b in (then.basis, still.basis)]
    assert said == [pytest.approx(squares[0] - squares[1], rel=1e-6)]
    grid, known = then.basis.grid, LinearModel(*here.case.model.linearised(spot.parameters, spot.parameters.free))
    hat = module.basis(there, spot.structure, "heat", grid, then.basis.chosen)
    assert then.weight == likeliest(known, hat)
    for spread in (0.97, 1.03):
        aside = module.basis(there, spot.structure, "heat", replace(grid, spread=spread * grid.spread), then.basis.chosen)
        assert best_beside(bare, aside, weight)[1] > squares[0]


def test_its_place_is_not_known_for_certain(one: tuple[Traced, Unlisted, Unlisted]) -> None:
    """Middle and spread are fitted with the parameters: two columns more than hats, and larger standard errors than beside a spot that is
    held."""
    here, _, spot = one
    assert spot.field is not None
    field, m = spot.field, len(spot.field.basis.chosen)
    assert field.basis.columns.shape[1] == m + 2 and len(field.q) == m + 2
    doubt = np.sqrt(np.diag(field.posterior)[m:])
    assert np.all(doubt > 0.0) and doubt[0] < 0.3 and doubt[1] < 0.1
    assert abs(field.basis.grid.y[0] - 8.0) < 4.0 * doubt[0]
    known = LinearModel(*here.case.model.linearised(spot.parameters, spot.parameters.free))
    hat = replace(field.basis, columns=field.basis.columns[:, :m], rough=field.basis.rough[:m, :m])
    free, held = (field_of(known, basis, here.rows, here.split, field.weight).uncertainty for basis in (field.basis, hat))
    assert np.all(free > held) and free.max() > 1.02 * held[free.argmax()]
    assert spot_of(field) == Spot(float(field.basis.grid.y[0]), field.basis.grid.spread)
    assert spot_of(replace(field, q=field.q[:-1])).spread is None, "at the least the mesh does not show it"


def test_two_spots_are_not_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """What one spot leaves stands out, though parameters settle beside it. Where they do not, that is said."""
    for second in (-0.7, -0.2):
        two = told(across(0.8, 12.0, 2.5), across(second, -14.0, 2.5))
        assert as_spot(*two) == (None, "one spot leaves structure")
    monkeypatch.setattr(module, "MOST_STEPS", 1)
    assert as_spot(*two) == (None, UNSETTLED)


def test_parameters_beside_a_spot_that_travels(monkeypatch: pytest.MonkeyPatch) -> None:
    """A spot at rest leaves structure, one that travels does not; parameters come back beside it, which the broad source had off. It is
    asked for where the hats show that it travels."""

    def source(x: np.ndarray, y: np.ndarray, time: float) -> np.ndarray:
        middle = -11.0 + 0.2 * time
        on = 0.25 * (1.0 + np.tanh((time - 15.0) / 2.0)) * (1.0 - np.tanh((time - 100.0) / 2.0))
        return np.asarray(0.9 * on * np.exp(-0.5 * ((y - middle) / 3.0) ** 2) / (np.sqrt(2.0 * np.pi) * 3.0) + 0.0 * x)

    here, found = told(source)
    spot, why = as_spot(here, found)
    assert spot is not None and spot.field is not None and why == ""
    place = spot_of(spot.field)
    assert place.velocity is not None and place.time is not None
    assert abs(place.velocity[0] - 0.2) < 3.0 * place.velocity[1] < 0.02 and place.y == pytest.approx(-11.0 + 0.2 * place.time, abs=0.4)
    off = [(spot.parameters[n] - BASE[n]) / s for n, s in zip(spot.parameters.free, spot.field.uncertainty, strict=True)]
    assert np.abs(off).max() < 3.0, off
    monkeypatch.setattr(module, "travels", lambda *_: None)
    assert as_spot(here, found) in [(None, LEAVES), (None, UNSETTLED)]


def test_where_nothing_settles_beside_one_that_travels_it_is_one_at_rest(
    monkeypatch: pytest.MonkeyPatch, one: tuple[Traced, Unlisted, Unlisted]
) -> None:
    """And where hats show no way it is at rest from the first."""
    here, found, spot = one
    asked: list[Grid] = []

    def fitted_spot(there: Traced, missing: Unlisted, grid: Grid) -> Any:
        asked.append(grid)
        return (None, UNSETTLED) if grid.along is not None else (spot, "")

    monkeypatch.setattr(module, "fitted_spot", fitted_spot)
    assert as_spot(here, found) == (spot, "") and [g.along for g in asked] == [None]
    monkeypatch.setattr(module, "travels", lambda *_: np.array([3.0, 0.2, 50.0]))
    asked.clear()
    assert as_spot(here, found) == (spot, "") and len(asked) == 2 and asked[1].along is None
    assert asked[0].y == 3.0 and asked[0].along is not None and np.allclose(asked[0].along, 0.2 * (asked[0].time - 50.0))


def test_a_spot_that_the_mesh_may_not_show_tells_no_parameters(one: tuple[Traced, Unlisted, Unlisted]) -> None:
    """Where its errors cannot be told beside it."""
    here, found, _ = one
    spot, why = as_spot(replace(here, case=replace(here.case, refined_at=None)), found)
    assert spot is None and "errors of the mesh" in why


def test_what_is_the_same_everywhere_is_no_spot(one: tuple[Traced, Unlisted, Unlisted]) -> None:
    here, found, _ = one
    assert found.field is not None
    grid = replace(found.field.basis.grid, x=np.zeros(1), y=np.zeros(1))
    assert as_spot(here, replace(found, field=replace(found.field, basis=replace(found.field.basis, grid=grid)))) == (None, "")
    assert as_spot(here, replace(found, field=replace(found.field, basis=replace(found.field.basis, kind="displacement")))) == (None, "")
    assert as_spot(here, replace(found, field=None)) == (None, "")


@pytest.mark.parametrize(
    ("names", "held"), [(("kappa", "rate_power.K", "rate_power.m"), ("rate_power.m",)), (("kappa", "local_source.place"), ())]
)
def test_exponents_of_a_law_are_held_where_nothing_settles_beside_them(
    monkeypatch: pytest.MonkeyPatch, one: tuple[Traced, Unlisted, Unlisted], names: tuple[str, ...], held: tuple[str, ...]
) -> None:
    """A second fit holds those that displacements show; where there is none, or the spot leaves structure, there is no second one."""
    here, found, _ = one
    model = LinearModel(np.zeros(6), np.arange(6.0 * len(names)).reshape(6, len(names)))
    at = replace(here.case, parameters=here.case.parameters.with_free(names))
    asked: list[Traced] = []
    answers = [(None, UNSETTLED), (found, "")]

    def fitted_spot(there: Traced, *_: Any) -> Any:
        asked.append(there)
        return answers[len(asked) - 1]

    monkeypatch.setattr(module, "fitted_spot", fitted_spot)
    with_law = replace(here, case=at, problem=replace(here.problem, model=model))
    assert as_spot(with_law, found) == answers[1 if held else 0]
    last = asked[-1]
    assert len(asked) == (2 if held else 1) and last.case.parameters.free == tuple(n for n in names if n not in held)
    assert np.array_equal(last.problem.model.columns, model.columns[:, : len(names) - len(held)])
    assert last.case.parameters.values == at.parameters.values
    asked.clear()
    answers[0] = (None, "one spot leaves structure")
    assert as_spot(with_law, found) == answers[0] and len(asked) == 1
