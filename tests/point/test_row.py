"""A row of points in series: it is a point where all sections are alike, one force goes through it, and its derivatives are exact."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.point.driver import PointHistory, PointSettings, Programme, simulate
from thermofit.point.row_driver import RowProgramme, axial_temperatures, simulate_row

HOT = 723.15
VALUES = {
    "E": 50e3, "nu": 0.33, "M_y0": 40.0, "M_yinf": 90.0, "H_exp": 6.0, "theta_air": HOT, "theta_clamp": 293.15, "theta_ref": HOT,
    "thermal_softening.slope": 4e-3, "thermal_softening.reference": HOT,
}  # fmt: skip
SEEN = {"heating_profile.fall": 2e-3, "heating_profile.centre": 0.3, "rate_logarithmic.C": 0.05}
PLACE = np.linspace(-8.0, 8.0, 5)


def pulled(on: dict[str, float], end: float = 0.12, steps: int = 30, area: np.ndarray | None = None) -> list[PointHistory]:
    return simulate_row(Parameters.of({**VALUES, **on}), (), programme(end, steps, area), HOT)[0]


def programme(end: float, steps: int, area: np.ndarray | None = None) -> RowProgramme:
    time = np.linspace(0.0, 1.5, steps + 1)
    n = len(PLACE)
    return RowProgramme(time, end * time / time[-1], np.full(n, 1.0 / n), PLACE, np.ones(n) if area is None else area)


def of(histories: list[PointHistory], channel: str) -> np.ndarray:
    return np.array([getattr(history, channel) for history in histories])


def test_sections_that_are_alike_are_one_point() -> None:
    found, driven = pulled({"rate_logarithmic.C": 0.05}), programme(0.12, 30)
    alone = simulate(
        Parameters.of({**VALUES, "rate_logarithmic.C": 0.05}), Programme.by_strain(driven.time, driven.mean, HOT), PointSettings()
    )
    for history in found:
        assert np.allclose(history.stress, alone.stress, rtol=1e-9) and np.allclose(history.strain, driven.mean, atol=1e-12)
        assert np.allclose(history.theta, alone.theta, atol=1e-6)


def test_one_force_goes_through_all_sections_and_their_mean_strain_is_the_prescribed_one() -> None:
    area = np.array([1.0, 0.99, 0.98, 1.0, 1.02])
    found, driven = pulled(SEEN, area=area), programme(0.12, 30)
    force = area[:, None] * of(found, "stress")
    assert np.ptp(force, axis=0).max() < 1e-8 * force.max()
    assert np.allclose(of(found, "strain").mean(axis=0), driven.mean, atol=1e-11)
    theta = of(found, "theta")[:, 0]
    assert theta == pytest.approx(HOT - 2e-3 * (PLACE - 0.3) ** 2 * (HOT - 293.15), abs=0.2), "begins at the temperature that heating holds"


def test_the_section_of_smaller_area_strains_more_as_the_curve_of_one_point_says() -> None:
    """Without rate and temperature P is a function of the strain: A_1 P(e_1) = A_2 P(e_2) along the curve of sections that are alike."""
    plain = {"thermal_softening.slope": 0.0, "M_yinf": 200.0}
    curve = pulled(plain, end=0.2, steps=400)[0]
    found = pulled(plain, area=np.array([0.97, 1.0, 1.0, 1.0, 1.0]), steps=120)
    e = of(found, "strain")[:2, -1]
    stress = np.interp(e, curve.strain, curve.stress)
    assert 0.97 * stress[0] == pytest.approx(stress[1], rel=1e-4)
    assert e[0] > e[1] + 0.01 and 0.2 * e[0] + 0.8 * e[1] == pytest.approx(0.12, abs=1e-9)


def test_a_row_without_rate_dependence_localises_in_one_section() -> None:
    """Beyond the largest force the hottest section takes all, and the others unload: the sections hold it, no step fails."""
    found = pulled({"heating_profile.fall": 2e-4}, end=0.3, steps=60)
    late = of(found, "strain")[:, -1] - of(found, "strain")[:, -5]
    assert late[2] > 0.0 and np.all(late[[0, 1, 3, 4]] < 1e-6)
    assert np.ptp(of(found, "stress")[:, -1]) < 1e-7


@pytest.mark.parametrize("name", ["M_yinf", "H_exp", "heating_profile.fall", "heating_profile.centre", "rate_logarithmic.C", "c0"])
def test_derivatives_pass_a_taylor_test_of_second_order(name: str) -> None:
    base = Parameters.of({**VALUES, **SEEN})
    histories, rates = simulate_row(base, (name,), programme(0.12, 30), HOT)
    at, slope = of(histories, "strain"), np.array([r["strain"][:, 0] for r in rates])
    size = 0.1 * abs(base[name])
    left = []
    for h in (size, 0.5 * size):
        moved = simulate_row(base.replace(**{name: base[name] + h}), (), programme(0.12, 30), HOT)[0]
        left.append(float(np.abs(of(moved, "strain") - at - h * slope).max()))
    assert np.abs(slope).max() > 0.0
    assert left[0] / left[1] > 3.4, left


def test_temperatures_along_the_axis_and_their_derivatives() -> None:
    base = Parameters.of({**VALUES, **SEEN})
    theta, along = axial_temperatures(base, ("heating_profile.fall", "M_y0", "heating_profile.centre"), PLACE, HOT)
    assert np.allclose(theta, HOT - 2e-3 * (PLACE - 0.3) ** 2 * 430.0)
    assert np.allclose(along, np.stack([-((PLACE - 0.3) ** 2) * 430.0, 0.0 * PLACE, 2.0 * 2e-3 * (PLACE - 0.3) * 430.0], axis=1))
    assert np.array_equal(axial_temperatures(Parameters.of(VALUES), (), PLACE, HOT)[0], np.full(5, HOT))


def test_a_row_that_cannot_be_pulled_says_when() -> None:
    with pytest.raises(NumericsError, match=r"mean strain .* at .* s is not reached after 12 halvings"):
        pulled({"heating_profile.fall": 3e-2}, end=40.0, steps=2)
