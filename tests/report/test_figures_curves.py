"""Figures of many coupon records show those that the model misses, and say what they leave out."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from matplotlib.figure import Figure

from thermofit.records.artefact import Dataset
from thermofit.report import figures_curves


class Verify:
    """A record of `verify` on coupons: `errors` over the noise by record, the records of `hot` with a temperature."""

    def __init__(self, errors: list[float], hot: tuple[int, ...] = ()) -> None:
        rows: list[dict[str, Any]] = [{"record": f"r{n}", "stress_over_noise": e} for n, e in enumerate(errors)]
        for n in hot:
            rows[n]["dtheta_over_noise"] = errors[n]
        channels = {"stress": {}, **({"dtheta": {}} if hot else {})}
        self.summary = {"records": rows, "channels": channels}
        time = np.linspace(0.0, 1.0, 5)
        self.data = {"stress/sigma": np.ones((5, 1, 1)), "theta/sigma": np.ones((5, 1, 1))}
        for n in range(len(errors)):
            names = ("time", "strain", "stress", "theta_sensor", "measured_strain", "measured_stress", "measured_theta")
            self.data |= {f"curves/{n}/{name}": time for name in names}

    def has(self, name: str) -> bool:
        return name in self.data

    def __getitem__(self, name: str) -> Dataset:
        return Dataset(self.data[name], "1", ("sample",))


@pytest.fixture(autouse=True)
def no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures of the search need records of identifications, which are not the point here."""
    for name in ("objective_figure", "correlation_figure"):
        monkeypatch.setattr(figures_curves, name, lambda _: None)


def figures(errors: list[float], hot: tuple[int, ...] = ()) -> dict[str, Figure]:
    return figures_curves.records_figures(cast(Any, {"verify": Verify(errors, hot)}))


def titles(figure: Figure) -> list[str]:
    return [text.partition(":")[0] for ax in figure.axes if (text := ax.get_title())]


@pytest.mark.parametrize("name", ["stress-time", "stress-strain"])
def test_the_worst_record_is_drawn_wherever_it_stands(name: str) -> None:
    errors = [1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 90.0, 1.7, 1.8]
    figure = figures(errors)[name]
    assert titles(figure) == ["r4", "r5", "r6", "r7", "r8", "r9"], "the six worst, in the order of the study"
    assert figure.get_suptitle() == "the 6 of 10 records with the largest error; 4 left out, at most 1.3 times the noise"


def test_all_are_drawn_where_they_are_few() -> None:
    found = figures([1.0, 5.0, 1.0, 1.0, 9.0])
    for name in ("stress-time", "stress-strain"):
        assert titles(found[name]) == ["r0", "r1", "r2", "r3", "r4"] and found[name].get_suptitle() == ""


def test_temperatures_are_those_of_the_records_that_have_one() -> None:
    found = figures([1.0, 5.0, 1.0, 1.0, 9.0, 2.0, 3.0, 1.0], hot=(3, 7))
    assert titles(found["temperature"]) == ["r3", "r7"] and found["temperature"].get_suptitle() == ""
