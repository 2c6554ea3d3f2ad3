"""Scores of dormant effects on linear problems whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from thermofit.core.errors import UntrustworthyError
from thermofit.core.parameters import Param, declare, param
from thermofit.diagnose.held_out import Rows, proof, split_by_blocks
from thermofit.diagnose.score import CONVINCING, Columns, indistinguishable, likeness, ranked
from thermofit.fit.linear_model import LinearModel

N, P = 4000, 6
for _name in ("made", "other", "third", "fourth"):
    declare((Param(f"made_{_name}.a", "1", 0.0, -100.0, 100.0, 1.0, "amplitude", probe=1.0),))
declare((Param("made_positive.a", "1", 0.0, 0.0, 100.0, 1.0, "amplitude", probe=1.0),))
declare((Param("made_pair.a", "1", 0.0, -9.0, 9.0, 1.0, "one", probe=1.0), Param("made_pair.b", "1", 0.0, -9.0, 9.0, 1.0, "two")))


def problem(seed: int = 0) -> tuple[np.random.Generator, np.ndarray, dict[str, tuple[tuple[str, ...], np.ndarray]]]:
    random = np.random.default_rng(seed)
    fitted = random.normal(size=(N, P))
    dormant = {f"made_{n}": ((f"made_{n}.a",), random.normal(size=(N, 1)) * 0.3) for n in ("made", "other", "third", "fourth")}
    return random, fitted, dormant


def test_planted_effect_is_first_with_its_estimate_and_drop() -> None:
    random, fitted, dormant = problem()
    # residual = prediction - observation of a model that lacks the effect: minus its columns
    residual = random.normal(size=N) - 0.5 * dormant["made_third"][1][:, 0]
    residual -= fitted @ np.linalg.lstsq(fitted, residual, rcond=None)[0]
    found = ranked(Columns(LinearModel(residual, fitted), dormant))
    first = found.scores[0]
    assert first.effect == "made_third" and first.z > 5.0 > found.threshold > 1.9
    assert first.estimate["made_third.a"] == pytest.approx(0.5, abs=4 * first.sigma["made_third.a"])
    full = np.concatenate([fitted, dormant["made_third"][1]], axis=1)
    rest = residual - full @ np.linalg.lstsq(full, residual, rcond=None)[0]
    assert first.predicted_drop == pytest.approx(residual @ residual - rest @ rest, rel=1e-9)
    assert first.z == pytest.approx(np.sqrt(first.predicted_drop), rel=1e-9)
    # what convinces held out is more than the threshold asks, and more than three thousandths of these few rows
    assert first.detectable == pytest.approx(CONVINCING * first.sigma["made_third.a"]) and CONVINCING == pytest.approx(4.449, abs=1e-3)


@pytest.mark.parametrize("n", [2000, 20000])  # few rows: the standard error decides; many: what is worth an effect
@pytest.mark.parametrize("correlated", [False, True])
def test_an_effect_as_small_as_is_said_is_named_half_of_the_time(n: int, correlated: bool) -> None:
    """At `detectable` z passes the threshold and held-out data convince with even odds; at half of it hardly ever, at twice always."""
    random = np.random.default_rng(3)
    fitted, block = random.normal(size=(n, P)), 0.3 * random.normal(size=(n, 1))
    if correlated:  # neighbours err alike, and the effect shows in them alike
        block = np.repeat(block[: n // 4], 4, axis=0)
    rows = Rows(np.zeros(n, dtype=int), np.arange(float(n)), np.zeros((n, 2)), np.zeros(n, dtype=int))
    split = split_by_blocks(rows, (25, 1), (0.0, 0.0))
    anywhere = np.full(1, np.inf)

    def noise(a: np.ndarray) -> np.ndarray:
        return np.repeat(a.reshape(n // 4, 4, -1).sum(axis=1), 4, axis=0) if correlated else a

    def named(times: float) -> float:
        count = 0
        for _ in range(40):
            error = np.repeat(random.normal(size=n // 4), 4) if correlated else random.normal(size=n)
            fresh = Columns(LinearModel(error, fitted, noise), {"made_made": (("made_made.a",), block)})
            residual = error - times * ranked(fresh).scores[0].detectable * block[:, 0]
            model = LinearModel(residual, fitted, noise)
            found = ranked(Columns(model, fresh.dormant))
            held = proof(model, block, (-anywhere, anywhere), rows, split)
            count += found.scores[0].z > found.threshold and held.convinces
        return count / 40

    assert named(0.5) < 0.1 and 0.25 < named(1.0) < 0.75 and named(2.0) > 0.9


def test_what_a_fitted_parameter_takes_up_is_not_an_effect() -> None:
    """A column inside the span of the fitted ones is unfelt; one nearly inside has a small detectability."""
    random, fitted, dormant = problem()
    dormant["made_made"] = (("made_made.a",), fitted @ np.ones((P, 1)))
    dormant["made_other"] = (("made_other.a",), fitted @ np.ones((P, 1)) + 1e-3 * random.normal(size=(N, 1)))
    found = ranked(Columns(LinearModel(random.normal(size=N), fitted), dormant))
    assert found.unfelt == ("made_made",)
    other = next(s for s in found.scores if s.effect == "made_other")
    assert 1e-4 < other.detectability < 1e-2


def test_effects_that_look_alike_are_one_family() -> None:
    random, fitted, dormant = problem()
    dormant["made_other"] = (("made_other.a",), dormant["made_made"][1] + 0.05 * random.normal(size=(N, 1)))
    found = ranked(Columns(LinearModel(random.normal(size=N), fitted), dormant))
    families = {s.effect: set(s.family) for s in found.scores}
    assert families["made_made"] == families["made_other"] == {"made_made", "made_other"}
    assert families["made_third"] == {"made_third"}
    assert likeness({"a": dormant["made_made"][1], "b": -dormant["made_made"][1]})["a", "b"] == pytest.approx(1.0)


def test_estimate_outside_its_bounds_is_vetoed() -> None:
    random, fitted, _ = problem()
    s = random.normal(size=(N, 1))
    found = ranked(Columns(LinearModel(0.01 * random.normal(size=N) + s[:, 0], fitted), {"made_positive": (("made_positive.a",), s)}))
    assert "outside" in found.scores[0].vetoed and found.scores[0].estimate["made_positive.a"] < param("made_positive.a").lower


def test_no_effect_passes_by_chance_more_often_than_said() -> None:
    """The largest of four |z| passes the threshold in about LEVEL of the tests with nothing planted."""
    random, fitted, dormant = problem()
    passed = 0
    for _ in range(400):
        found = ranked(Columns(LinearModel(random.normal(size=N), fitted), dormant))
        passed += max(s.z for s in found.scores) > found.threshold
    assert 6 <= passed <= 36


def test_rows_that_hang_together_count_as_few() -> None:
    """Residual and column constant within 40 groups: the plain z is far too sure, that by groups is not."""
    random, fitted, _ = problem()
    groups = np.repeat(np.arange(40), N // 40)
    large = []
    for _ in range(200):
        s, r = random.normal(size=40)[groups], 3.0 * random.normal(size=40)[groups]
        dormant = {"made_made": (("made_made.a",), s[:, None])}
        assert ranked(Columns(LinearModel(r, fitted), dormant)).scores[0].z >= 0.0
        large.append(ranked(Columns(LinearModel(r, fitted), dormant, groups=groups)).scores[0].z > 2.6)
    assert np.mean(large) < 0.06


def test_error_of_the_discretisation_is_scored_like_the_residual() -> None:
    random, fitted, dormant = problem()
    error = 0.2 * dormant["made_other"][1][:, 0]
    found = ranked(Columns(LinearModel(random.normal(size=N), fitted), dormant, numerical=error))
    drops = {s.effect: s.numerical_drop for s in found.scores}
    s = dormant["made_other"][1][:, 0]
    s = s - fitted @ np.linalg.lstsq(fitted, s, rcond=None)[0]
    assert drops["made_other"] == pytest.approx(0.04 * s @ s, rel=1e-9) and drops["made_third"] < 0.01 * drops["made_other"]


def test_two_params_of_one_effect_are_judged_together() -> None:
    random, fitted, _ = problem()
    block = random.normal(size=(N, 2))
    residual = random.normal(size=N) - block @ [0.0, 0.2]
    found = ranked(Columns(LinearModel(residual, fitted), {"made_pair": (("made_pair.a", "made_pair.b"), block)})).scores[0]
    assert found.z > 5.0 and found.estimate["made_pair.b"] == pytest.approx(0.2, abs=4 * found.sigma["made_pair.b"])


def test_more_parameters_than_data_is_refused() -> None:
    with pytest.raises(UntrustworthyError, match="nothing to judge"):
        ranked(Columns(LinearModel(np.ones(3), np.eye(3)), {}))


def test_an_effect_that_cannot_be_is_no_alternative() -> None:
    """One whose own estimate lies outside its bounds explains nothing, however alike it looks."""
    random, fitted, _ = problem()
    s = random.normal(size=(N, 1))
    dormant = {"made_made": (("made_made.a",), s), "made_positive": (("made_positive.a",), s + 0.05 * random.normal(size=(N, 1)))}
    found = {x.effect: x for x in ranked(Columns(LinearModel(s[:, 0] + 0.1 * random.normal(size=N), fitted), dormant)).scores}
    assert found["made_positive"].vetoed and not found["made_made"].vetoed
    assert found["made_made"].family == ("made_made",)


def test_two_fitted_effects_that_look_alike_are_named() -> None:
    """After what the other parameters take: alike there, not alike, alone."""
    random, fitted, _ = problem()
    s = random.normal(size=(N, 1))
    twin = s + 0.1 * random.normal(size=(N, 1)) + 3.0 * fitted[:, :1]
    found = indistinguishable(np.concatenate([fitted, s, twin], axis=1), {"one": [P], "two": [P + 1]})
    assert found is not None and found[:2] == ("one", "two") and found[2] > 0.95
    apart = np.concatenate([fitted, s, random.normal(size=(N, 1))], axis=1)
    assert indistinguishable(apart, {"one": [P], "two": [P + 1]}) is None
    assert indistinguishable(apart, {"one": [P]}) is None


def test_what_was_tried_besides_raises_the_threshold() -> None:
    """Other values of an exponent are chances to fit by luck: forty directions more ask for as much as forty effects would."""
    random, fitted, dormant = problem()
    residual = random.normal(size=N)
    tried = tuple(random.normal(size=(N, 1)) for _ in range(40))
    alone = ranked(Columns(LinearModel(residual, fitted), dormant))
    scanned = ranked(Columns(LinearModel(residual, fitted), dormant, also_tried=tried))
    count = len(dormant) + len(tried)
    assert scanned.threshold == pytest.approx(norm.isf(0.5 * (1.0 - 0.95 ** (1.0 / count))), rel=0.01)
    assert scanned.threshold > alone.threshold + 0.6 and [s.z for s in scanned.scores] == [s.z for s in alone.scores]
