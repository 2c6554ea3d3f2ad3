"""A heat source that no law names: the answer of the fitted model to it is that of a run with an effect file of the same source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from virtual_pulls import SIZE, TRUTH, data, model, part, study

from thermofit.body.body import about_middle
from thermofit.body.heat.one_way import heat_run
from thermofit.core import parameters as declared
from thermofit.core.parameters import Parameters
from thermofit.diagnose.unlisted_effect import heat_file, over_time_file
from thermofit.effects import catalogue
from thermofit.effects.catalogue import load_effect
from thermofit.experiment.known_motion import freely_expanding
from thermofit.experiment.missing import KINDS, spot_values
from thermofit.experiment.missing_body import OF_SURFACE, BodyMissing, closer

NAME = "planted_for_missing_body"


def test_answer_is_that_of_a_run_with_the_effect_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hats of two places, in every channel's whitened rows, within 4 % of the largest; volumes are those of the whole specimen."""
    monkeypatch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    monkeypatch.setattr(declared, "OF_EFFECTS", dict(declared.OF_EFFECTS))
    joint, base = model(study()), Parameters.of(TRUTH)
    assert isinstance(joint.missing, BodyMissing) and joint.missing.folded
    grid = joint.missing.grid("heat", (5, 4, 2))
    values = np.zeros(grid.shape)
    values[2, 1, :, 0], values[3, 2, 0, 0] = 0.2, 0.3
    volumes = joint.missing.volumes(grid)
    assert volumes is not None
    gauge = 25.0 * 1.2 * (grid.y[-1] - grid.y[0])
    assert 0.7 * gauge < volumes.sum() < 1.1 * gauge, "integrated by few elements"
    path = tmp_path / f"{NAME}.py"
    path.write_text(heat_file(NAME, "a test", grid, values[..., 0], True), encoding="utf-8")
    load_effect(path)
    rows = part(joint, "dtheta")
    change = (joint.residual(base.replace(**{f"{NAME}.scale": 1.0})) - joint.residual(base))[rows]
    chosen = np.flatnonzero(values.ravel())
    answers = joint.missing.answers("heat", base, grid, chosen)["theta"]
    expected = joint.comparisons[-1].residual(answers @ values.ravel()[chosen])
    assert np.abs(change).max() > 5.0
    assert np.abs(expected - change).max() < 0.04 * np.abs(change).max()
    assert SIZE.n_y == 8 and len(data().phases) == 4


@pytest.mark.parametrize("spread", [0.1, 2.0, 9.0])
@pytest.mark.parametrize("middle", [-7.0, 0.4, 6.25])
def test_a_spot_has_its_power_and_its_middle_however_small_it_is(middle: float, spread: float) -> None:
    """On elements that are many times as high: 1 mW/mm^2 of the cross-section, and the first moment of it."""
    missing = model(study()).missing
    assert isinstance(missing, BodyMissing)
    least = missing.spot(5)
    assert least.places == 1 and len(least.time) == 5
    grid = replace(least, y=np.array([middle]), spread=spread)
    (volume,) = np.asarray(missing.volumes(grid))
    assert volume == pytest.approx(25.0 * 1.2, rel=1e-3 if spread < 5.0 else 0.02), "beyond the parallel length it is wider"
    ends = np.linspace(-60.0, 60.0, 9)
    low, high = ends[:-1], ends[1:]
    points = 0.5 * (low + high)[:, None] + 0.5 * (high - low)[:, None] * np.array([-1.0, 1.0]) / np.sqrt(3.0)
    weighed = spot_values(grid, low, high, points)[..., 0] * 0.5 * (high - low)[:, None]
    assert weighed.sum() == pytest.approx(1.0) and (weighed * points).sum() == pytest.approx(middle)
    heights = np.unique(np.round(about_middle(missing.body)[1], 6))
    assert 0.0 < least.spread == pytest.approx(0.1 * float(np.max(np.diff(heights))))


def test_a_spot_that_travels_is_at_every_time_where_it_is_then() -> None:
    """The answer to every hat in time is that of a spot at rest there; of all with an amount it is their sum."""
    joint, base = model(study()), Parameters.of(TRUTH)
    missing = joint.missing
    assert isinstance(missing, BodyMissing)
    rest = replace(missing.spot(5), spread=3.0)
    along = np.array([-8.0, -3.0, 1.0, 4.0, 9.0])
    grid = replace(rest, y=np.array([1.5]), along=along)
    assert grid.places == 1 and grid.size == 5 and grid.heights == pytest.approx(1.5 + along)
    chosen = np.array([0, 2, 3, 4])
    (found,) = (missing.answers("heat", base, grid, chosen)[field] for field in ("theta",))
    for n, k in enumerate(chosen):
        there = missing.answers("heat", base, replace(rest, y=grid.heights[k : k + 1]), chosen[n : n + 1])["theta"]
        assert np.abs(there).max() > 1e-3 and found[..., n] == pytest.approx(there[..., 0], abs=1e-9 * np.abs(there).max())
    amount = np.array([1.0, -2.0, 0.5, 3.0])
    slopes = missing.slopes("heat", base, grid, chosen, amount, ("kappa",))["theta"][..., 0]
    step = 1e-3 * base["kappa"]
    more = missing.answers("heat", base.replace(kappa=base["kappa"] + step), grid, chosen)["theta"] @ amount
    assert slopes == pytest.approx((more - found @ amount) / step, abs=2e-3 * np.abs(slopes).max())


@pytest.mark.parametrize("kind", ["heat", "displacement", *OF_SURFACE, "offset", "gradient", "clock", "strain", "scale"])
def test_an_amount_of_each_hat_is_their_sum(kind: str) -> None:
    """In every field, also through the lens of a camera; one column."""
    joint, base = model(study()), Parameters.of({**TRUTH, "ir_registration.shift_y": 0.8, "ir_gain.gain": 0.1})
    assert isinstance(joint.missing, BodyMissing)
    grid = joint.missing.grid(kind, (5, 4, 2))
    chosen = np.arange(grid.size)
    amount = np.random.default_rng(1).normal(size=grid.size)
    each, whole = joint.missing.answers(kind, base, grid, chosen), joint.missing.answers(kind, base, grid, chosen, amount)
    assert list(each) == list(whole)
    for field, value in each.items():
        assert whole[field].shape == (*value.shape[:3], 1) and np.abs(value).max() > 0.0
        assert whole[field][..., 0] == pytest.approx(value @ amount, abs=1e-9 * np.abs(value).max())


@pytest.mark.parametrize(
    ("kind", "channel", "amount", "within"),
    [
        ("flux", "dtheta", 0.02, 3e-3),
        ("film", "dtheta", 20.0, 0.01),
        ("jaws", "dtheta", 2.0, 0.01),
        ("jaw_upper", "dtheta", 2.0, 0.01),
        ("jaw_lower", "dtheta", 2.0, 0.01),
        ("offset", "dtheta", 0.2, 1e-6),
        ("gradient", "dtheta", 10.0, 1e-6),
        ("clock", "dtheta", 3.0, 1e-6),
        ("strain", "du", 1.0, 1e-6),
        ("scale", "du", 40.0, 1e-6),
    ],
)
def test_answer_of_a_term_of_no_place_is_that_of_a_run_with_its_effect_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, channel: str, amount: float, within: float
) -> None:
    """On from the first time, and the other way round in between: mW per current area of what the jaws leave free, K of jaws, mm/m of
    lengths or displacements. What is warmer is longer. Of cameras to the digits of the file; what comes through the surface by the heat
    equation of a known motion, while the run couples. The specimen rests in the balance without it at first."""
    monkeypatch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    monkeypatch.setattr(declared, "OF_EFFECTS", dict(declared.OF_EFFECTS))
    joint, base = model(study()), Parameters.of(TRUTH)
    assert isinstance(joint.missing, BodyMissing) and joint.missing.of_surface == {"theta": OF_SURFACE}
    assert joint.missing.of_instruments == {"theta": ("offset", "gradient", "clock"), "u": ("strain", "scale")}
    grid = joint.missing.grid(kind, (320, 1, 1))
    seen = joint.observations["theta" if channel == "dtheta" else "u"].time
    assert len(grid.time) == len(seen) if "jaw" not in kind else len(grid.time) > len(seen), "as dense as it is observed, or denser"
    assert np.all(np.min(np.abs(grid.time[:, None] - seen), axis=0) < 1e-9)
    # A film may be none, but not less.
    values = amount * (np.cos(2.0 * np.pi * grid.time / grid.time[-1]) + (kind == "film"))
    grid = replace(grid, y=np.array([6.5 if KINDS[kind].about else 0.0]), level=values if kind == "film" else None)
    path = tmp_path / f"{NAME}.py"
    path.write_text(over_time_file(kind, NAME, "a test", grid, values), encoding="utf-8")
    load_effect(path)
    rows = part(joint, channel)
    change = (joint.residual(base.replace(**{f"{NAME}.scale": 1.0})) - joint.residual(base))[rows]
    elsewhere = joint.missing.answers(kind, base, grid, np.arange(grid.size))
    assert next(iter(elsewhere)) == ("theta" if channel == "dtheta" else "u"), "the field that shows the kind comes first"
    answers = elsewhere.pop("theta" if channel == "dtheta" else "u")
    (comparison,) = (c for c in joint.comparisons if c.channel == channel)
    expected = comparison.residual(answers @ values)
    assert np.abs(change).max() > 4.0
    assert np.abs(expected - change).max() < within * np.abs(change).max()
    # A pixel is given to the point that the displacement cameras say is there, and what is warmer expands.
    other, times = ("dtheta", 1.0) if channel == "du" else ("du", 1.0 if kind == "film" else 30.0)
    assert set(elsewhere) == (set() if kind in ("offset", "gradient", "clock") else {"theta" if channel == "du" else "u"})
    for also in elsewhere.values():
        change = (joint.residual(base.replace(**{f"{NAME}.scale": times})) - joint.residual(base))[part(joint, other)] / times
        (comparison,) = (c for c in joint.comparisons if c.channel == other)
        told = comparison.residual(also @ values)
        assert np.abs(change).max() > 1e-3
        if channel == "du":
            assert np.abs(told - change).max() < 1e-5 * np.abs(change).max()
        else:  # from a jaw it is held back a little by what is colder at its side, and bends
            near, alike = (0.06, 0.97) if kind.startswith("jaw") else (0.006, 0.9998)
            assert told @ change / (change @ change) == pytest.approx(1.0, abs=near) and np.corrcoef(told, change)[0, 1] > alike


@pytest.mark.parametrize("stretch", [0.0, 0.25])
def test_a_stretched_specimen_expands_by_its_length_now(stretch: float) -> None:
    """Between the ends of what is observed by alpha_exp times the mean temperature and the length there, where nothing flows."""
    missing, base = model(study()).missing, Parameters.of({**TRUTH, "M_y0": 900.0, "M_yinf": 950.0})
    assert isinstance(missing, BodyMissing)
    history, seen = missing.history(base), missing.instruments.observations
    u = history.u.copy()
    u[1:, :, 1] += stretch * missing.body.mesh.nodes[:, 1]
    there, grid = missing.on(replace(history, u=u), base), missing.grid("flux", (6, 1, 1))
    asked = "flux", base, grid, np.arange(grid.size)
    shown = {field: value.sum(axis=3) for field, value in there.answers(*asked).items()}
    warmer, moved = shown["theta"][:, :, 0], shown["u"][:, :, 1]
    y = seen["u"].xy[:, 1]
    longer = moved[:, y == y.max()].mean(axis=1) - moved[:, y == y.min()].mean(axis=1)
    mean = np.interp(seen["u"].time, seen["theta"].time, warmer.mean(axis=1))
    length = (1.0 + stretch) * float(np.ptp(y))
    assert longer[1:] == pytest.approx(base["alpha_exp"] * mean[1:] * length, rel=0.02)


def test_what_has_flowed_last_is_told_though_no_stage_is_there() -> None:
    """Displacements of the stages after the largest force are the same whether one was taken there or not."""
    missing, base = model(study()).missing, Parameters.of(TRUTH)
    assert isinstance(missing, BodyMissing)
    instruments, flow = missing.instruments, missing.flow(base)
    assert flow is not None
    largest = int(np.flatnonzero(flow.last)[-1])
    seen, look = instruments.observations["u"], instruments.samplers["u"]
    rows = np.flatnonzero(look.index != largest)
    assert len(rows) == len(look.index) - 1 and rows[-1] > largest
    fewer = replace(seen, time=seen.time[rows], value=seen.value[rows], sigma=seen.sigma[rows], mask=seen.mask[rows])
    less = replace(
        instruments,
        observations={**instruments.observations, "u": fewer},
        samplers={**instruments.samplers, "u": replace(look, index=look.index[rows])},
    )
    grid = missing.grid("flux", (6, 1, 1))
    asked = "flux", base, grid, np.arange(grid.size)
    every, found = (one.answers(*asked)["u"] for one in (missing, replace(missing, instruments=less)))
    assert np.abs(every[-1]).max() > 0.0 and found == pytest.approx(every[rows], abs=1e-12 * np.abs(every).max())


def test_a_specimen_whose_end_is_moved_does_not_expand_freely() -> None:
    """Its ends stay where they are; nor is there anything to see where displacements are not observed."""
    missing, base = model(study()).missing, Parameters.of(TRUTH)
    assert isinstance(missing, BodyMissing)
    grid = missing.grid("jaws", (6, 1, 1))
    held = replace(missing, whole=replace(missing.whole, loading=replace(missing.whole.loading, control="displacement")))
    seen = {name: one for name, one in missing.instruments.observations.items() if name != "u"}
    blind = replace(missing, instruments=replace(missing.instruments, observations=seen))
    assert [set(one.answers("jaws", base, grid, np.arange(grid.size))) for one in (missing, held, blind)] == [
        {"theta", "u"},
        {"theta"},
        {"theta"},
    ]


def test_knots_are_no_farther_apart_than_asked() -> None:
    """Where frames are rare jaws may do as much as elsewhere: what they do there is not known, and no straight line."""
    assert closer(np.array([0.0, 1.0, 2.0, 7.0, 9.0]), 2.0).tolist() == pytest.approx([0.0, 1.0, 2.0, 2.0 + 5 / 3, 2.0 + 10 / 3, 7.0, 9.0])
    joint = model(study())
    seen = joint.observations["theta"].time
    rare = seen[np.r_[0:6, 6 : len(seen) : 4]]
    observed = {**joint.missing.instruments.observations, "theta": SimpleNamespace(time=rare)}  # type: ignore[union-attr]
    missing = SimpleNamespace(instruments=SimpleNamespace(observations=observed))
    grids = {kind: BodyMissing.grid(missing, kind, (320, 1, 1)).time for kind in ("jaws", "flux", "offset")}  # type: ignore[arg-type]
    assert np.allclose(grids["flux"], rare) and np.allclose(grids["offset"], rare)
    assert (
        np.all(np.min(np.abs(grids["jaws"][:, None] - rare), axis=0) < 1e-9)
        and np.diff(grids["jaws"]).max() <= 2.0 * np.median(np.diff(rare)) + 1e-9
    )


def test_an_error_of_the_clock_is_seen_through_the_camera() -> None:
    """A camera that shows half as much again of every difference shows as much more of what changes in a second."""
    joint, base = model(study()), Parameters.of(TRUTH)
    assert isinstance(joint.missing, BodyMissing)
    grid = joint.missing.grid("clock", (5, 1, 1))
    plain, gained = (
        joint.missing.answers("clock", p, grid, np.arange(grid.size))["theta"] for p in (base, base.replace(**{"ir_gain.gain": 0.5}))
    )
    assert np.abs(plain).max() > 0.01 and gained == pytest.approx(1.5 * plain, rel=1e-9, abs=1e-12)


JAWS = [kind for kind in OF_SURFACE if KINDS[kind].alike == "jaws"]


def test_both_jaws_are_the_upper_and_the_lower_one() -> None:
    """What they show adds up."""
    joint, base = model(study()), Parameters.of(TRUTH)
    assert joint.missing is not None
    grid = joint.missing.grid("jaws", (6, 1, 1))
    both, upper, lower = (joint.missing.answers(kind, base, grid, np.arange(grid.size))["theta"] for kind in JAWS)
    assert (
        np.allclose(upper + lower, both, rtol=0.0, atol=1e-9 * np.abs(both).max())
        and np.abs(upper - lower).max() > 0.1 * np.abs(both).max()
    )


@pytest.mark.parametrize(
    ("kind", "shift"), [("heat", 0.3), ("flux", 0.3), ("film", 0.3), ("jaw_upper", 0.3), ("jaw_upper", 0.0), ("offset", 0.3)]
)
def test_slopes_of_a_term_on_a_known_motion_are_of_second_order(kind: str, shift: float) -> None:
    """Taylor test: what all parameters change of what the term adds, at two sizes of a step; a quarter of the remainder for half a step.
    Also where the camera has no pose yet. None of what does not run through the heat equation. What a film lets out goes with the
    temperatures of a heat run of these parameters on that motion. How much further the specimen flows as it warms is that of the run."""
    joint = model(study())
    assert isinstance(joint.missing, BodyMissing)
    base = Parameters.of({**TRUTH, "ir_registration.shift_y": shift})
    names = ("kappa", "c0", "alpha_air", "alpha_clamp", "ir_registration.shift_y", "beta", "alpha_exp")
    grid = joint.missing.grid(kind, (6, 4, 2))
    chosen = np.arange(grid.size)
    amount = np.random.default_rng(2).normal(size=grid.size)
    grid = replace(grid, level=5.0 * np.arange(6.0)) if kind == "film" else grid
    slopes = joint.missing.slopes(kind, base, grid, chosen, amount, names)
    assert set(slopes) == {"offset": set(), "heat": {"theta"}}.get(kind, {"theta", "u"}), "of many places temperatures alone tell"
    history = joint.missing.history(base, points=True)
    problem = freely_expanding(joint.missing.whole, history)
    direction = np.array([3.0, -0.4, 5.0, -40.0, 0.2, 0.1, 2e-6])

    def shown(missing: BodyMissing, parameters: Parameters, field: str) -> np.ndarray:
        return missing.answers(kind, parameters, grid, chosen)[field] @ amount

    def remainder(part: float, field: str) -> float:
        assert isinstance(joint.missing, BodyMissing)
        moved = base.replace(**{n: base[n] + part * d for n, d in zip(names, direction, strict=True)})
        warm = heat_run(problem, moved) - heat_run(problem, base) if kind == "film" else 0.0
        key, flow = tuple(sorted(moved.values.items())), joint.missing.flow(base)
        on_it = replace(joint.missing, kept={key: replace(history, theta=history.theta + warm)}, flows={} if flow is None else {key: flow})
        change = shown(on_it, moved, field) - shown(joint.missing, base, field)
        return float(np.abs(change - part * (slopes[field] @ direction)).max() / np.abs(change).max())

    for field, slope in slopes.items():
        flows = slope[..., names.index("beta")].any()
        assert slope.shape[-1] == len(names) and flows == (kind == "film"), "no heat of flow is changed but by a film, which lets it out"
        one, half = remainder(0.1, field), remainder(0.05, field)
        assert one < 0.05 and half < 0.55 * one


@pytest.mark.parametrize(
    ("name", "most"), [("kappa", 0.01), ("c0", 0.02), ("alpha_air", 0.01), ("alpha_clamp", 0.01), ("beta", 0.001), ("alpha_exp", 0.04)]
)
def test_slopes_of_a_film_are_nearly_those_of_whole_runs(name: str, most: float) -> None:
    """Beside finite differences of coupled runs, part of the largest value; thermal expansion moves the specimen, which heat runs leave."""
    missing, base = model(study()).missing, Parameters.of(TRUTH)
    assert isinstance(missing, BodyMissing)
    grid = replace(missing.grid("film", (6, 4, 2)), level=5.0 * np.arange(6.0))
    chosen, amount = np.arange(grid.size), np.random.default_rng(2).normal(size=grid.size)
    slopes, step = missing.slopes("film", base, grid, chosen, amount, (name,)), 1e-3 * base[name]

    def shown(by: float) -> Mapping[str, np.ndarray]:
        moved = base.replace(**{name: base[name] + by})
        return {field: value @ amount for field, value in replace(missing, kept={}).answers("film", moved, grid, chosen).items()}

    after, before = shown(step), shown(-step)
    for field, slope in slopes.items():
        whole = (after[field] - before[field]) / (2.0 * step)
        assert np.abs(slope[..., 0] - whole).max() < most * np.abs(whole).max()
