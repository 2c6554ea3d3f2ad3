"""Drawn starts fill the bounds, in the order of magnitude where that is what is unknown, and harden."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.identify.draws import between, drawn_starts
from thermofit.study.search import DrawnStarts
from thermofit.study.section import ParameterStart
from thermofit.study.study import Study

SETTINGS = {
    "M_y0": ParameterStart(start=140.0, bounds=(50.0, 300.0)),
    "M_yinf": ParameterStart(start=290.0, bounds=(100.0, 900.0)),
    "alpha_clamp": ParameterStart(start=200.0, bounds=(1.0, 1e6)),
}
STUDY = Study.model_construct(parameters=SETTINGS, source=__import__("pathlib").Path("a.yaml"))
BASE = Parameters.of({"M_y0": 140.0, "M_yinf": 290.0, "alpha_clamp": 200.0}, tuple(SETTINGS))


@pytest.mark.parametrize("method", ["latin-hypercube", "sobol"])
def test_starts_fill_the_bounds_and_repeat_with_the_seed(method: str) -> None:
    draw = DrawnStarts.model_validate({"method": method, "number": 16, "seed": 3})
    starts = drawn_starts(STUDY, draw, BASE)
    assert starts == drawn_starts(STUDY, draw, BASE) != drawn_starts(STUDY, draw.model_copy(update={"seed": 4}), BASE)
    assert len(starts) == 16 and all(list(start) == list(SETTINGS) for start in starts)
    for start in starts:
        assert start["M_yinf"] >= 1.01 * start["M_y0"]
        assert all(SETTINGS[name].bounds[0] <= value <= SETTINGS[name].bounds[1] for name, value in start.items())  # type: ignore[index]
    # Sixteen strata of each range hold one start each: of alpha_clamp in its logarithm.
    share = np.sort([np.log10(start["alpha_clamp"]) / 6.0 for start in starts])
    assert np.array_equal(np.floor(share * 16), np.arange(16))
    share = np.sort([(start["M_y0"] - 50.0) / 250.0 for start in starts])
    assert np.array_equal(np.floor(share * 16), np.arange(16))


def test_narrower_ranges_are_kept_and_checked() -> None:
    draw = DrawnStarts(number=5, seed=1, within={"alpha_clamp": (100.0, 400.0)})
    assert all(100.0 <= start["alpha_clamp"] <= 400.0 for start in drawn_starts(STUDY, draw, BASE))
    with pytest.raises(StudyError, match=r"a\.yaml: key 'gridsearch\.draw\.within\.alpha_clamp' is \[0\.5, 400\]; expected a range inside"):
        drawn_starts(STUDY, DrawnStarts(number=5, seed=1, within={"alpha_clamp": (0.5, 400.0)}), BASE)
    with pytest.raises(StudyError, match=r"within' gives kappa, which the stage does not identify"):
        drawn_starts(STUDY, DrawnStarts(number=5, seed=1, within={"kappa": (100.0, 400.0)}), BASE)
    with pytest.raises(StudyError, match=r"M_yinf cannot lie above M_y0 = 2\d\d"):
        drawn_starts(STUDY, DrawnStarts(number=5, seed=1, within={"M_yinf": (110.0, 200.0), "M_y0": (220.0, 300.0)}), BASE)


def test_a_range_of_decades_is_drawn_by_its_logarithm() -> None:
    assert between(0.5, 1.0, 1e4) == pytest.approx(100.0) and between(0.5, 1.0, 99.0) == 50.0 and between(0.5, 0.0, 1e4) == 5e3
