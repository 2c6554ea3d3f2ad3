"""Coupon records: columns, units, signs, clocks, repairs, cuts, phases, thinning and noise, on records that the tests make."""

from __future__ import annotations

import datetime as dt
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from thermofit.core.errors import DataError, StudyError
from thermofit.core.experiment import CouponRecord
from thermofit.experiment.coupon_elastic import elastic_line
from thermofit.experiment.coupon_records import coupon_test
from thermofit.read.coupon import coupon_files, read_coupon
from thermofit.read.coupon_clocks import clock_offset
from thermofit.read.coupon_phases import coupon_phases, thinned, turning_points
from thermofit.read.coupon_repair import CouponRows, longest_rise, wild_samples
from thermofit.read.coupon_signs import branch_suspicion, sign_suspicion, thermoelastic_slope
from thermofit.study.coupon import Coupon

E, YIELD, ALPHA = 200e3, 400.0, -1.0e-3
"""MPa, MPa, thermoelastic K/MPa."""


def cycles(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Strain (triangle, 1 %, period 40 s), stress of an ideally plastic bar, and its temperature with plastic heating, at times t in s."""
    strain = 0.01 * np.interp(t % 40.0, [0, 10, 30, 40], [0, 1, -1, 0])
    stress, plastic, heat = np.zeros_like(t), 0.0, np.zeros_like(t)
    for k in range(1, t.size):
        trial = E * (strain[k] - plastic)
        stress[k] = np.clip(trial, -YIELD, YIELD)
        change = (trial - stress[k]) / E
        plastic += change
        heat[k] = heat[k - 1] + 0.9 * abs(stress[k] * change) / 3.6
    return strain, stress, 296.0 + ALPHA * stress + heat


def table(names: str, columns: list[np.ndarray]) -> str:
    return names + "\n" + "".join(",".join(f"{x:.9g}" for x in row) + "\n" for row in np.stack(columns, axis=1))


def record(folder: Path, text: str, **settings: Any) -> CouponRecord:
    """The record of one file with the columns t, e, s unless the settings say otherwise."""
    (folder / "test.csv").write_text(text, encoding="utf-8")
    given = {"file": "test.csv", "time": "t[s]", "strain": "e[-]", "stress": "s[MPa]", "initial_temperature_degC": 20.0, **settings}
    given = {key: value for key, value in given.items() if value is not None}
    return read_coupon(Coupon.model_validate({"records": [given]}), folder)[0]


@pytest.fixture
def cyclic() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    t = np.arange(0.0, 80.0, 0.05)
    return (t, *cycles(t))


@pytest.fixture
def simple(cyclic: tuple[np.ndarray, ...]) -> str:
    t, e, s, _ = cyclic
    return table("t[s],e[-],s[MPa]", [t, e, s])


def test_force_and_extension_become_nominal(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, theta = cyclic
    text = table("t[min],x[in],F[lbf],T[degF]", [t / 60, -e * 8 / 25.4, -s * 28.0 / 4.4482216152605, theta * 1.8 - 459.67])
    got = record(
        tmp_path,
        text,
        time="t[min]",
        strain={"extension": "x[in]", "gauge_length": 8.0},
        stress={"force": "F[lbf]", "area": 28.0},
        temperature="T[degF]",
        tension="negative",
    )
    np.testing.assert_allclose(got.time, t, atol=1e-6)
    np.testing.assert_allclose(got.strain, e, atol=1e-10)
    np.testing.assert_allclose(got.stress, s, atol=1e-5)
    assert got.temperature is not None
    np.testing.assert_allclose(got.temperature, theta, atol=1e-5)
    assert (got.theta_start, got.theta_air) == (293.15, 293.15)
    assert any("signs of force and extension turned" in remark for remark in got.remarks)
    assert not any("flipped" in remark for remark in got.remarks)


def test_true_values_become_nominal_and_this_is_said(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, _ = cyclic
    text = table("t[s],et,st", [t, np.log1p(e), s * (1 + e)])
    got = record(tmp_path, text, strain={"true_strain": "et"}, stress={"true_stress": "st", "unit": "MPa"})
    np.testing.assert_allclose(got.strain, e, atol=1e-10)
    np.testing.assert_allclose(got.stress, s, atol=1e-5)
    assert sum("converted to nominal" in remark for remark in got.remarks) == 2


def test_sign_is_never_guessed_but_suspected(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, theta = cyclic
    text = table("t[s],e[-],s[MPa],T[K]", [t, -e, -s, theta])
    got = record(tmp_path, text, temperature="T[K]")
    np.testing.assert_allclose(got.stress, -s, atol=1e-5)
    assert any("the temperature rises by 0.001 K per MPa in elastic tension" in remark for remark in got.remarks)


def test_sign_of_each_channel(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, _ = cyclic
    text = table("t[s],e[-],s[MPa]", [t, e, -s])
    assert any("signs of both contradict" in remark for remark in record(tmp_path, text).remarks)
    got = record(tmp_path, text, stress={"column": "s[MPa]", "tension": "negative"})
    np.testing.assert_allclose(got.stress, s, atol=1e-5)
    assert not any("contradict" in remark for remark in got.remarks)


def test_contradicting_signs_are_seen_through_noise() -> None:
    """A long flow curve with the sign of the strain turned: single steps of the stress are noise."""
    strain = np.linspace(0.0, 0.6, 20000)
    stress = 60.0 * np.tanh(strain / 0.01) - 20.0 * strain + np.random.default_rng(3).normal(0.0, 1.0, strain.size)
    assert branch_suspicion(strain, stress) is None
    assert "signs of both contradict" in (branch_suspicion(-strain, stress) or "")


def test_suspicion_sees_through_lag_noise_and_drift(cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, theta = cyclic
    lagged = np.interp(t - 2.8, t, theta) + 0.01 * t / 80 + np.random.default_rng(1).normal(0, 0.005, t.size)
    slope = thermoelastic_slope(t, s, lagged)
    assert slope is not None and slope[0] == pytest.approx(ALPHA, rel=0.1)
    assert sign_suspicion(t, s, lagged) is None
    assert "flipped" in (sign_suspicion(t, -s, lagged) or "")
    assert sign_suspicion(t, s, np.random.default_rng(2).normal(0, 0.01, t.size)) is None
    assert sign_suspicion(t, s, np.full_like(t, 300.0)) is None
    assert branch_suspicion(e, s) is None and "compression" in (branch_suspicion(-np.abs(e), -np.abs(s)) or "")


@pytest.mark.parametrize(
    ("stress", "area"),
    [
        ({"area": 12.5}, 12.5),
        ({"diameter": 5.98}, np.pi * 5.98**2 / 4),
        ({"width": 6.0, "thickness": 1.5}, 9.0),
        ({"thickness": 1.5}, 4.89 * 1.5),
        ({}, 7.335),
    ],
)
def test_area_of_study_or_header(tmp_path: Path, cyclic: tuple[np.ndarray, ...], stress: dict[str, float], area: float) -> None:
    t, e, s, _ = cyclic
    header = '"Cross-section",7.335,"mm^2"\n"Specimen width",4.89,"mm"\n"Gage length",30,"mm"\n'
    text = header + table('"Time","Standard force","Strain"\n"s","N","mm"', [t, s * area, 30.0 * e])
    got = record(tmp_path, text, time="Time", strain={"extension": "Strain"}, stress={"force": "Standard force", **stress})
    np.testing.assert_allclose(got.stress, s, atol=1e-4)
    np.testing.assert_allclose(got.strain, e, atol=1e-9)
    assert any("gauge length 30 mm from the header" in remark for remark in got.remarks)


def test_time_from_a_rate(tmp_path: Path) -> None:
    strain = np.linspace(0, 0.1, 101) + np.where(np.arange(101) % 10 == 5, -2e-3, 0.0) * 0.45
    text = table("e,s", [strain, 300 * np.tanh(strain * 200)])
    got = record(tmp_path, text, time=None, rate=1e-3, strain="e", stress={"column": "s", "unit": "ksi"})
    np.testing.assert_allclose(got.time, got.strain / 1e-3, atol=1e-9)
    assert got.stress.max() == pytest.approx(300 * 6.894757293, rel=1e-6)
    assert any("time built from the strain at 0.001 1/s" in remark for remark in got.remarks)
    with pytest.raises(DataError, match="the strain never changes, so a rate cannot build the time"):
        record(tmp_path, table("e,s", [0 * strain, strain]), time=None, rate=1e-3, strain="e", stress={"column": "s", "unit": "ksi"})


def test_time_from_a_rate_drops_the_fewest_rows(tmp_path: Path) -> None:
    """Two readings before the gauge was set, and a high one, cost themselves, and not the rows until they are passed."""
    strain = np.linspace(0.0, 0.1, 1001)
    stress = np.minimum(40e3 * strain, 40.0)
    read = np.concatenate([[9e-4, 9e-4], strain])
    read[502] += 5e-4
    text = table("e,s [MPa]", [read, np.concatenate([[0.0, 0.0], stress])])
    got = record(tmp_path, text, time=None, rate=1e-3, strain="e", stress="s [MPa]")
    assert "3 rows dropped with which the strain would not go on" in got.remarks
    np.testing.assert_allclose(got.strain, np.delete(strain, 500), atol=1e-9)
    np.testing.assert_allclose(got.time, got.strain / 1e-3, atol=1e-9)
    line = elastic_line(got.time, got.strain, got.stress, 1e-8)
    assert line is not None and line.slope == pytest.approx(40e3, rel=1e-3)


@given(st.lists(st.integers(0, 12), min_size=1, max_size=12))
def test_longest_rise(values: list[int]) -> None:
    """It rises, and no choice of rows that rises is longer."""
    x = np.array(values, dtype=float)
    found = longest_rise(x)
    assert (np.diff(found) > 0).all() and (np.diff(x[found]) > 0.0).all()
    longest = np.ones(len(x), dtype=int)
    for k in range(len(x)):
        longest[k] += max(longest[:k][x[:k] < x[k]], default=0)
    assert len(found) == longest.max()


def test_longest_rise_takes_the_first_of_equal_values() -> None:
    """A bar that relaxes at one strain is taken as it came there."""
    assert longest_rise(np.array([0.0, 1.0, 1.0, 2.0, 2.0, 2.0])).tolist() == [0, 1, 3]


def test_time_of_cycles_along_the_path_of_the_strain(tmp_path: Path) -> None:
    """There and back the clock goes on: 0 to 1 %, to -1 %, to 0 at 1e-3 1/s are 40 s; the rows of a hold have no time and are counted."""
    t = np.linspace(0.0, 40.0, 401)
    strain, stress, _ = cycles(t)
    strain, stress = np.insert(strain, 200, strain[[199, 199]]), np.insert(stress, 200, 0.9 * stress[[199, 199]])
    got = record(tmp_path, table("e,s [MPa]", [strain, stress]), time=None, rate=1e-3, strain="e", stress="s [MPa]")
    np.testing.assert_allclose(got.time, t, atol=1e-6)
    assert any("along the path of the strain with 2 reversals at 0.001 1/s" in remark for remark in got.remarks)
    assert "2 rows dropped with which the strain would not go on between two reversals" in got.remarks


def test_time_from_the_number_of_the_row(tmp_path: Path) -> None:
    t = np.linspace(0.0, 40.0, 401)
    strain, stress, _ = cycles(t)
    got = record(tmp_path, table("e,s [MPa]", [strain, stress]), time=None, sampling_rate=10, strain="e", stress="s [MPa]")
    np.testing.assert_allclose(got.time, t, atol=1e-9)
    assert any("from the number of the row at 10 rows per second, which the file does not confirm" in remark for remark in got.remarks)


def test_rate_and_temperature_of_comment_lines(tmp_path: Path) -> None:
    """Neither stands in the study; both are used and said. A clock of the file is never passed over for a rate."""
    strain = np.linspace(0, 0.1, 101)
    head = "# Temperature: 400 K\n# strain rate = 5e-3 1/s\n"
    settings: dict[str, Any] = {"time": None, "strain": "e", "stress": "s [MPa]", "initial_temperature_degC": None}
    got = record(tmp_path, head + table("e,s [MPa]", [strain, 300 * np.tanh(strain * 200)]), **settings)
    assert (got.theta_start, got.time[-1]) == (400.0, pytest.approx(20.0))
    assert "strain rate 0.005 1/s from the header of the file" in got.remarks
    clocked = head + table("t [s],e,s [MPa]", [strain / 1e-4, strain, 300 * np.tanh(strain * 200)])
    with pytest.raises(StudyError, match=r"time' is missing, and .* has the clock t \[s\]: name it, or give rate"):
        record(tmp_path, clocked, **settings)
    got = record(tmp_path, clocked, **{**settings, "time": "t [s]"})
    assert any("the header says a strain rate of 0.005 1/s, the record has 0.0001 1/s" in remark for remark in got.remarks)
    with pytest.raises(StudyError, match=r"says no strain rate: name the column of time, or give rate"):
        record(tmp_path, table("e,s [MPa]", [strain, strain]), **settings)


def test_columns_by_number(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    """In a table without names, and in one with names as well."""
    t, e, s, _ = cyclic
    settings = {"time": {"column": 1, "unit": "s"}, "strain": 2, "stress": {"column": 3, "unit": "MPa"}}
    bare = table("", [t, e, s]).lstrip()
    for text in (bare, table("a,b,c", [t, e, s])):
        got = record(tmp_path, text, **settings)
        np.testing.assert_allclose(got.stress, s, atol=1e-5)
    with pytest.raises(StudyError, match=r"strain' is column 7, but .* has 3 columns"):
        record(tmp_path, bare, **{**settings, "strain": 7})


@pytest.mark.parametrize(
    ("names", "settings", "words"),
    [
        ("t[s],true strain,s[MPa]", {"strain": "true strain"}, r"as nominal strain, but its name says true; write \{true_strain: "),
        (
            "t[s],e[-],wahre Spannung [MPa]",
            {"stress": "wahre Spannung"},
            r"as nominal stress, but its name says true; write \{true_stress: ",
        ),
        (
            "t[s],eng. strain,s[MPa]",
            {"strain": {"true_strain": "eng. strain"}},
            r"as true strain, but its name says nominal; write \{column: ",
        ),
        (
            "t[s],e[-],engineering stress [MPa]",
            {"stress": {"true_stress": "engineering stress"}},
            r"as true stress, but its name says nominal",
        ),
    ],
)
def test_words_of_true_and_nominal_against_the_study(
    tmp_path: Path, cyclic: tuple[np.ndarray, ...], names: str, settings: dict[str, Any], words: str
) -> None:
    """A contradiction is refused; where the study insists it is a remark."""
    t, e, s, _ = cyclic
    with pytest.raises(StudyError, match=words):
        record(tmp_path, table(names, [t, e, s]), **settings)
    ((key, source),) = settings.items()
    insisted = {key: {**({"column": source} if isinstance(source, str) else source), "despite_name": True}}
    got = record(tmp_path, table(names, [t, e, s]), **insisted)
    assert any("despite its name, as the study says" in remark for remark in got.remarks)


def test_words_that_agree_say_nothing(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, _ = cyclic
    text = table("t[s],technische Dehnung,true stress [MPa]", [t, e, s * (1 + e)])
    got = record(tmp_path, text, strain="technische Dehnung", stress={"true_stress": "true stress"})
    np.testing.assert_allclose(got.stress, s, atol=1e-5)
    assert not any("despite" in remark for remark in got.remarks)


def test_a_wild_sample_is_told_and_kept(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, _ = cyclic
    noisy = s + np.random.default_rng(5).normal(0.0, 2.0, s.size)
    assert not any("wild" in remark for remark in record(tmp_path, table("t[s],e[-],s[MPa]", [t, e, noisy])).remarks)
    noisy[700] += 900.0
    text = table("t[s],e[-],s[MPa]", [t, e, noisy])
    got = record(tmp_path, text)
    said = next(remark for remark in got.remarks if "wild" in remark)
    assert said.startswith("1 wild samples of the stress, far off their neighbours: row 700 (") and "kept as they are" in said
    assert got.time.size == t.size and got.stress.max() > 800.0
    got = record(tmp_path, text, leave_out=[700])
    assert got.time.size == t.size - 1 and got.stress.max() < 600.0 and not any("wild" in remark for remark in got.remarks)
    assert "1 data rows left out, as the study says" in got.remarks
    with pytest.raises(StudyError, match="leave_out' names row 5000, but the record has the rows 0 to 1599"):
        record(tmp_path, text, leave_out=[5000])


@given(st.integers(3, 40), st.floats(0.0, 1e-3), st.integers(0, 2**31))
def test_reversals_and_noise_are_no_wild_samples(rows_per_branch: int, noise: float, seed: int) -> None:
    """Saw teeth of any coarseness with noise, plastic or not."""
    t = np.arange(0.0, 160.0, 10.0 / rows_per_branch)
    strain, stress, _ = cycles(t)
    random = np.random.default_rng(seed)
    strain, stress = strain * (1.0 + random.normal(0.0, 1e-4, t.size)), stress + random.normal(0.0, 1e3 * noise + 1e-9, t.size)
    assert wild_samples(CouponRows(t, strain, stress, None, (), None, np.arange(t.size))) == []


def test_noise_of_a_hold_is_no_wild_sample() -> None:
    """Of 20000 samples of noise some lie five times farther out than their neighbours lie apart."""
    t = np.arange(20000.0)
    noise = np.random.default_rng(7).normal(0.0, 1.0, t.size)
    assert wild_samples(CouponRows(t, 1e-6 * t, noise, None, (), None, np.arange(t.size))) == []


@pytest.mark.parametrize("names", ["t[s],e[-],s[MPa],lateral strain [%]", "t[s],e[-],s[MPa],Querdehnung [%]"])
def test_lateral_strain_is_a_channel_with_gaps(tmp_path: Path, cyclic: tuple[np.ndarray, ...], names: str) -> None:
    t, e, s, _ = cyclic
    lines = table(names, [t, e, s, -30.0 * e]).splitlines()
    lines[11] = lines[11].rpartition(",")[0] + ","
    got = record(tmp_path, "\n".join(lines), lateral=names.rpartition(",")[2])
    assert got.lateral is not None and got.time.size == t.size
    known = np.isfinite(got.lateral)
    np.testing.assert_allclose(got.lateral[known], -0.3 * e[known], atol=1e-9)
    assert (~known).sum() == 1 and any("1 of 1600 rows without value" in remark for remark in got.remarks)
    assert not any("contraction" in remark for remark in got.remarks) and "lateral" in got.noise
    thin = record(tmp_path, "\n".join(lines), lateral=names.rpartition(",")[2], points=200)
    assert thin.lateral is not None and thin.lateral.size == thin.time.size
    assert record(tmp_path, "\n".join(lines)).lateral is None


def test_lateral_strain_from_a_change_of_width(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, _ = cyclic
    text = table("t[s],e[-],F[N],change of width [mm]", [t, e, 25.0 * s, 3.75 * e])
    stress = {"force": "F", "width": 12.5, "thickness": 2.0}
    wrong = record(tmp_path, text, stress=stress, lateral={"extension": "change of width"})
    assert any("the lateral strain grows with the strain" in remark for remark in wrong.remarks)
    got = record(tmp_path, text, stress=stress, lateral={"extension": "change of width", "contraction": "positive"})
    assert got.lateral is not None
    np.testing.assert_allclose(got.lateral, -0.3 * e, atol=1e-9)
    with pytest.raises(StudyError, match=r"lateral.width' is missing"):
        record(tmp_path, text, stress={"force": "F", "area": 25.0}, lateral={"extension": "change of width"})


def test_one_of_several_tests_in_a_long_table(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    """Rows chosen by a column of text or of numbers; what is constant in them speaks of the test."""
    t, e, s, _ = cyclic
    text = "file,temp [degC],t[s],e[-],s[MPa]\n" + "".join(
        f"{name},{hot},{a:.9g},{b:.9g},{c * f:.9g}\n"
        for name, hot, f in (("A 1", 20, 1.0), ("B", 300, 0.5))
        for a, b, c in zip(t, e, s, strict=True)
    )
    for where in ({"file": "B"}, {"temp [degC]": 300}):
        got = record(tmp_path, text, where=where, initial_temperature_degC=None)
        np.testing.assert_allclose(got.stress, 0.5 * s, atol=1e-5)
        assert got.theta_start == pytest.approx(573.15) and got.time.size == t.size
        assert any(remark.startswith("1600 of 3200 rows: ") for remark in got.remarks)
    with pytest.raises(StudyError, match=r"where.file' is 'C', but no row of .* holds it; there are A 1, B"):
        record(tmp_path, text, where={"file": "C"})
    with pytest.raises(DataError, match="the time goes back"):
        record(tmp_path, text)


@pytest.mark.parametrize("offset", [17.3, -9.21])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_two_clocks_are_joined(tmp_path: Path, cyclic: tuple[np.ndarray, ...], offset: float, sign: float) -> None:
    t, e, s, _ = cyclic
    grow = 1.0 + t / 80.0
    later = np.arange(-5.0, 78.0, 0.1)
    load = sign * 28.0 * np.interp(later, t, s * grow)
    second = table("clock[s],Load[N],T[degC]", [later + offset, load, 20.0 + 0.1 * later])
    (tmp_path / "second.csv").write_text(second, encoding="utf-8")
    got = record(tmp_path, table("t[s],e[-],s[MPa]", [t, e, s * grow]), temperature={"column": "T[degC]", "file": "second.csv"})
    assert got.temperature is not None
    np.testing.assert_allclose(got.temperature, 293.15 + 0.1 * got.time, atol=2e-3)
    said = next(remark for remark in got.remarks if "clock of the temperature" in remark)
    assert (
        f"{offset:.2f}" in said.replace(f"{offset:.3f}", f"{offset:.2f}")
        or abs(float(said.split(" is ")[1].split(" s")[0]) - offset) < 0.02
    )
    assert any("rows that miss a channel dropped" in remark for remark in got.remarks), "rows after the end of the second file"
    given = record(
        tmp_path,
        table("t[s],e[-],s[MPa]", [t, e, s * grow]),
        temperature={"column": "T[degC]", "file": "second.csv", "offset_s": offset + 1.0},
    )
    assert given.temperature is not None
    np.testing.assert_allclose(given.temperature, 293.15 + 0.1 * (given.time + 1.0), atol=1e-6)


def test_clocks_that_cannot_be_joined_are_refused() -> None:
    t = np.arange(0.0, 100.0, 0.1)
    wave = np.sin(t)
    with pytest.raises(DataError, match=r"fit at two offsets .* s apart"):
        clock_offset((t, wave), (t, wave))
    with pytest.raises(DataError, match=r"correlate by 0.* at best"):
        clock_offset((t, np.random.default_rng(1).normal(size=t.size)), (t, np.random.default_rng(2).normal(size=t.size)))
    with pytest.raises(DataError, match="too short or constant"):
        clock_offset((t, wave), (t, np.ones_like(t)))


def test_uncertainty_of_the_offset_covers_the_error() -> None:
    t = np.arange(0.0, 60.0, 0.05)
    score = []
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0, 5.0, (2, t.size))
        signal = 500 * np.tanh((t % 23 - 11) / 4) * (1 + t / 60)
        found = clock_offset((t, signal + noise[0]), (t + 3.0171, signal + noise[1]))
        score.append((found.offset - 3.0171) / found.sigma)
    assert 0.3 < float(np.std(score)) < 3.0


def test_repairs_are_counted(tmp_path: Path, simple: str) -> None:
    lines = simple.splitlines()
    lines[100] = lines[99]
    lines[200] = ",".join([lines[199].split(",")[0], *lines[200].split(",")[1:]])
    lines[300] = lines[300].split(",")[0] + ",,"
    got = record(tmp_path, "\n".join(lines) + "\n,,\n")
    for words in (
        "1 repeated rows dropped",
        "1 rows that share the time of the row before merged",
        "1 rows that miss a channel dropped, 1 of them inside",
        "1 rows without any number dropped",
    ):
        assert any(remark.startswith(words) for remark in got.remarks), words
    assert got.time.size == 1600 - 3 and (np.diff(got.time) > 0).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda lines: [*lines[:50], *lines[60:70], *lines[50:60], *lines[70:]], "the time goes back from 3.4 s to 2.45 s at row 59"),
        (
            lambda lines: [lines[0], *[",".join([row.split(",")[0], "", row.split(",")[2]]) for row in lines[1:]]],
            "column 'e.-.' holds no numbers",
        ),
        (lambda lines: lines[:6], "5 rows with all channels found, expected at least 10"),
        (lambda lines: [lines[0], *[row if k % 3 else row.split(",")[0] + ",," for k, row in enumerate(lines[1:])]], "miss a channel"),
        (lambda lines: [lines[0], *["1.0," + row.split(",", 1)[1] for row in lines[1:]]], "share their time with the row before"),
    ],
    ids=["unsorted", "empty channel", "too short", "holes", "one time"],
)
def test_ambiguous_rows_are_refused(tmp_path: Path, simple: str, change: Any, words: str) -> None:
    with pytest.raises(DataError, match=words) as caught:
        record(tmp_path, "\n".join(change(simple.splitlines())))
    assert "test.csv" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"strain": "e[%]"}, r"key 'coupon.records.0.strain' is 'e\[%\]', but .*test.csv has no such column; did you mean 'e\[-\]'"),
        ({"strain": {"column": "e[-]", "unit": "furlong"}}, "unit 'furlong' of column 'e.-.' is not known"),
        ({"stress": {"force": "s[MPa]", "area": 3.0}}, "unit 'MPa' of column 's.MPa.' is one of stress, expected one of force"),
        ({"strain": {"extension": "e[-]", "unit": "mm"}}, "strain.gauge_length' is missing"),
        ({"stress": {"force": "s[MPa]", "unit": "N"}}, "stress.area' is missing"),
        ({"initial_temperature_degC": None}, "initial_temperature_degC' is missing"),
        ({"test": "A"}, "test' is 'A', but .* holds a single test"),
        ({"jumps": [5000]}, "names row 5000, but the record has the rows 0 to 1599"),
    ],
)
def test_what_the_study_must_say(tmp_path: Path, simple: str, settings: dict[str, Any], words: str) -> None:
    with pytest.raises(StudyError, match=words):
        record(tmp_path, simple, **settings)


def test_stress_without_unit_must_be_given_one(tmp_path: Path) -> None:
    text = table("t,e,s", [np.arange(20.0), np.arange(20.0) / 1e3, np.arange(20.0)])
    with pytest.raises(StudyError, match="column 's' has no unit in the file; give it"):
        record(tmp_path, text, time="t", strain="e", stress="s")
    got = record(tmp_path, text, time="t", strain="e", stress={"column": "s", "unit": "ksi"})
    assert any("'t' has no unit in the file and is taken as seconds" in remark for remark in got.remarks)
    assert any("'e' has no unit in the file and is taken as dimensionless" in remark for remark in got.remarks)


def test_unit_of_the_study_replaces_that_of_the_file(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, theta = cyclic
    text = table("t[s],e[-],s[GPa],T[degF]", [t, e, s, theta - 273.15])
    got = record(tmp_path, text, stress={"column": "s[GPa]", "unit": "ksi"}, temperature={"column": "T[degF]", "unit": "degC"})
    np.testing.assert_allclose(got.stress, 6.894757293 * s, rtol=1e-6, atol=1e-5)
    assert got.temperature is not None
    np.testing.assert_allclose(got.temperature, theta, atol=1e-5)
    assert any("unit ksi of the study replaces GPa of the file" in remark for remark in got.remarks)


def test_cuts(tmp_path: Path, simple: str) -> None:
    got = record(tmp_path, simple, window=[5.0, 60.0], exclude=[[20.0, 30.0]])
    assert got.time.min() == 5.0 and got.time.max() == 60.0 and not ((got.time >= 20) & (got.time <= 30)).any()
    assert record(tmp_path, simple, strain_max=0.005).strain.max() <= 0.005
    strain = np.linspace(0, 0.3, 301)
    necking = table("t[s],e[-],s[MPa]", [strain * 100, strain, 500 * strain**0.2 * (1 - strain)])
    assert record(tmp_path, necking, until="maximum-force").strain[-1] == pytest.approx(0.2 / 1.2, abs=2e-3)
    with pytest.raises(DataError, match="0 rows left after the cuts"):
        record(tmp_path, simple, window=[500.0, 600.0])


def test_jump_of_the_extensometer_is_taken_out(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, _ = cyclic
    slipped = e + np.where(np.arange(t.size) >= 700, 3e-3, 0.0)
    text = table("t[s],e[-],s[MPa]", [t, slipped, s])
    assert any("the strain steps without the stress at 35 s" in remark for remark in record(tmp_path, text).remarks)
    got = record(tmp_path, text, jumps=[700])
    np.testing.assert_allclose(got.strain, e, atol=1e-8)
    assert any("extensometer jump of 0.003 at row 700 taken out" in remark for remark in got.remarks)
    assert not any("steps without the stress" in remark for remark in got.remarks)


def test_phases_of_cycles_holds_and_rate_jumps() -> None:
    t = np.arange(0.0, 50.0, 0.05)
    strain = np.interp(t, [0, 5, 20, 25, 30, 40, 50], [0, 0, 0.015, 0.015, 0.0, 0.001, 0.02])
    strain += np.random.default_rng(3).normal(0, 1e-6, t.size)
    stress = np.clip(2e5 * strain, -400, 400)
    phases = coupon_phases(t, strain, stress)
    kinds = [label.split(" ")[0] for _, _, label in phases]
    assert kinds == ["hold", "elastic", "loading", "hold", "unloading", "loading", "loading"]
    np.testing.assert_allclose([t0 for t0, _, _ in phases], [0, 5, 7, 20, 25, 30, 40], atol=0.35)
    rates = [float(label.split(" ")[1].removesuffix("/s")) for _, _, label in phases]
    np.testing.assert_allclose(np.array(rates)[[1, 2, 4, 5, 6]], [1e-3, 1e-3, 3e-3, 1e-4, 1.9e-3], rtol=0.06)


def test_short_fast_end_of_a_branch_is_found() -> None:
    """A jump of the rate shortly before a reversal, shorter than the least stretch of windows."""
    t = np.arange(0.0, 110.0, 0.05)
    strain = np.interp(t, [0, 100, 101.4, 110], [0, 0.02, 0.03, 0.0])
    edges = [t0 for t0, _, _ in coupon_phases(t, strain, 2e5 * strain)]
    np.testing.assert_allclose(edges, [0, 100, 101.4], atol=0.051)


def test_turning_points_see_reversals_and_no_noise() -> None:
    t = np.arange(0.0, 80.0, 0.05)
    strain, _, _ = cycles(t)
    noisy = strain + np.random.default_rng(4).normal(0, 2e-5, t.size)
    np.testing.assert_allclose(t[turning_points(t, noisy)], [0, 10, 30, 50, 70, t[-1]], atol=0.3)


def test_thinning_keeps_turning_points_and_says_counts(tmp_path: Path, simple: str, cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, _ = cyclic
    got = record(tmp_path, simple, points=300)
    assert 290 <= got.time.size <= 300
    assert any(f"thinned from 1600 to {got.time.size} samples" in remark for remark in got.remarks)
    for k in turning_points(t, e):
        assert t[k] in got.time
    np.testing.assert_allclose(np.interp(t, got.time, got.strain), e, atol=2e-4)
    np.testing.assert_allclose(np.interp(t, got.time, got.stress), s, atol=8.0)
    assert np.array_equal(thinned(t, e, s, 5000), np.arange(t.size))


def test_a_thinned_record_keeps_all_samples_of_its_first_loading(tmp_path: Path) -> None:
    """A hot test at 100 samples per second: 4 s of elasticity between a rest, in which the gauge goes back and forth, and flow.

    Of 100 samples none or few lie on the line."""
    t = np.arange(0.0, 124.0, 0.01)
    strain = 3.75e-4 * np.clip(t - 20.0, 0.0, 4.0) + 5e-3 * np.clip(t - 24.0, 0.0, 100.0)
    stress = np.minimum(20e3 * strain, 30.0)
    down = t > 122.0
    strain[down], stress[down] = strain[down] - 0.1 * (t[down] - 122.0), stress[down] - 15.0 * (t[down] - 122.0)
    at_rest = np.where(t < 20.0, 5e-3 * np.sin(0.2 * np.pi * t), 0.0)
    noisy = strain + at_rest + np.random.default_rng(6).normal(0.0, 6e-5, t.size)
    text = table("t[s],e[-],s[MPa]", [t, noisy, stress])
    got, noted = record(tmp_path, text, strain="e[-]", stress="s[MPa]", points=100), record(tmp_path, text, strain="e[-]", stress="s[MPa]")
    assert noted.first_loading is None and got.first_loading is not None and got.time.size <= 100
    assert got.first_loading.time.size == pytest.approx(12200, abs=20) and got.first_loading.noise == got.noise
    ready, _ = coupon_test(got)
    assert ready.line is not None and ready.line.slope == pytest.approx(20e3, rel=0.03) and ready.line.error < 0.03
    alone = coupon_test(replace(got, first_loading=None))[0].line
    assert alone is None or alone.error > 0.035
    assert ready.strain[0] - got.strain[0] == pytest.approx(ready.elastic.strain[0] - got.first_loading.strain[0], abs=1e-12)
    flow = record(tmp_path, text, strain={"plastic_strain": "e[-]"}, stress={"true_stress": "s[MPa]"}, points=100)
    assert flow.first_loading is None


def test_noise_is_estimated_or_declared(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, _ = cyclic
    random = np.random.default_rng(5)
    text = table("t[s],e[-],s[MPa]", [t, e + random.normal(0, 3e-6, t.size), s + random.normal(0, 0.8, t.size)])
    assert record(tmp_path, text).noise == pytest.approx({"strain": 3e-6, "stress": 0.8}, rel=0.12)
    assert record(tmp_path, text, noise={"stress": 2.0}).noise["stress"] == 2.0


def test_files_and_variables(tmp_path: Path, simple: str, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a.csv").write_text(simple, encoding="utf-8")
    monkeypatch.setenv("RECORDS", str(tmp_path / "sub"))
    entry = {"time": "t[s]", "strain": "e[-]", "stress": "s[MPa]", "initial_temperature_degC": 20.0}
    coupon = Coupon.model_validate({"records": [{"file": "${RECORDS}/a.csv", **entry}, {"file": "sub/a.csv", "name": "again", **entry}]})
    assert coupon_files(coupon, tmp_path) == (tmp_path / "sub" / "a.csv",)
    first, second = read_coupon(coupon, tmp_path)
    assert (first.name, second.name) == ("a", "again")
    monkeypatch.delenv("RECORDS")
    with pytest.raises(StudyError, match=r"key 'coupon.records.0.file' is .* RECORDS is not set"):
        read_coupon(coupon, tmp_path)


def camera_and_machine(folder: Path, offset: float) -> tuple[np.ndarray, str]:
    """Times and table of a machine (time, force, extension); that of a camera whose clock is `offset` s ahead lies in camera.csv."""
    t = np.arange(0.0, 80.0, 0.05)
    later = np.arange(-3.0, 82.0, 0.25)
    grow = 1.0 + t / 80.0
    e, s, _ = cycles(t)
    machine = table("t[s],F[N],ext[mm]", [t, 28.0 * s * grow, 8.0 * e * grow])
    seen, loaded = np.interp(later, t, e * grow), np.interp(later, t, s * grow)
    camera = table("clock[s],e_cam[-],F_cam[V],ext_cam[mm]", [later + offset, seen, loaded / 100.0, 8.0 * seen])
    (folder / "camera.csv").write_text(camera, encoding="utf-8")
    return t, machine


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ({"repeats": "F_cam[V]"}, "which repeats the force"),
        ({"repeats": "ext_cam", "repeated": "ext[mm]"}, "which repeats the channel 'ext[mm]'"),
        ({"repeats": "ext_cam"}, "which repeats the extension 'ext[mm]'"),
        ({}, "which repeats the extension 'ext[mm]'"),
    ],
)
def test_strain_of_a_camera_with_its_own_clock(tmp_path: Path, source: dict[str, str], words: str) -> None:
    """Joined by the force of the camera or by the extension of the machine."""
    t, machine = camera_and_machine(tmp_path, 17.3)
    got = record(tmp_path, machine, strain={"column": "e_cam", "file": "camera.csv", **source}, stress={"force": "F[N]", "area": 28.0})
    e, _, _ = cycles(t)
    np.testing.assert_allclose(got.strain, np.interp(got.time, t, e * (1 + t / 80)), atol=2e-4)
    said = next(remark for remark in got.remarks if "clock of the strain" in remark)
    assert words in said and float(said.split(" is ")[1].split(" s")[0]) == pytest.approx(17.3, abs=0.03)


def test_two_clocks_of_one_table_and_of_one_workbook(tmp_path: Path) -> None:
    """Another time column of the same table, another sheet of the same workbook."""
    t, machine = camera_and_machine(tmp_path, -4.0)
    camera = (tmp_path / "camera.csv").read_text(encoding="utf-8")
    one, two = (text.splitlines() for text in (machine, camera))
    two += [",,,"] * (len(one) - len(two))
    both = "\n".join(f"{a},{b}" for a, b in zip(one, two, strict=True))
    e, _, _ = cycles(t)
    wanted = e * (1 + t / 80)
    stress = {"force": "F[N]", "area": 28.0}
    got = record(tmp_path, both, strain={"column": "e_cam", "time": "clock[s]", "repeats": "F_cam[V]"}, stress=stress)
    np.testing.assert_allclose(got.strain, np.interp(got.time, t, wanted), atol=2e-4)
    cells = [[[_cell(word) for word in line.split(",")] for line in text.splitlines()] for text in (machine, camera)]
    (tmp_path / "book.xlsx").write_bytes(workbook({"machine": cells[0], "camera": cells[1]}))
    strain = {"column": "e_cam", "test": "camera", "repeats": "F_cam[V]"}
    got = record(tmp_path, "", file="book.xlsx", test="machine", strain=strain, stress=stress)
    np.testing.assert_allclose(got.strain, np.interp(got.time, t, wanted), atol=2e-4)
    # The clock of the camera may be the one that counts, too.
    force = {"force": "F[N]", "area": 28.0, "test": "machine", "repeated": "F_cam[V]"}
    got = record(tmp_path, "", file="book.xlsx", test="camera", time="clock[s]", strain="e_cam", stress=force)
    assert got.time.size == pytest.approx(320, abs=4) and np.corrcoef(got.stress, np.interp(got.time + 4.0, t, cycles(t)[1]))[0, 1] > 0.9


def workbook(sheets: dict[str, list[list[float | str]]]) -> bytes:
    """A workbook of sheets of cells."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, cells in sheets.items():
        sheet = book.create_sheet(name)
        for row in cells:
            sheet.append(row)
    file = io.BytesIO()
    book.save(file)
    return file.getvalue()


def _cell(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word


@pytest.mark.parametrize("header", [False, True])
def test_clocks_joined_by_absolute_dates(tmp_path: Path, cyclic: tuple[np.ndarray, ...], header: bool) -> None:
    """Dates of rows, those of the machine cut off at whole seconds, or the start of each test in its header; 12.5 s apart."""
    t, e, s, _ = cyclic
    began = dt.datetime(2021, 6, 30, 23, 59, 30)
    later = np.arange(0.0, 110.0, 0.5)
    theta = 20.0 + 0.1 * later
    if header:
        text = f"# Start: {began:%Y-%m-%d %H:%M:%S}\n" + table("t[s],e[-],s[MPa]", [t, e, s])
        second = f"# Start: {began - dt.timedelta(seconds=12.5):%Y-%m-%d %H:%M:%S.%f}\n" + table("clock[s],T[degC]", [later, theta])
    else:
        stamps = [f"{began + dt.timedelta(seconds=float(x)):%Y-%m-%d %H:%M:%S}" for x in t]
        text = "t[s],e[-],s[MPa],stamp\n" + "".join(f"{a:.9g},{b:.9g},{c:.9g},{d}\n" for a, b, c, d in zip(t, e, s, stamps, strict=True))
        others = [f"{began + dt.timedelta(seconds=float(x) - 12.5):%d.%m.%Y %H:%M:%S.%f}" for x in later]
        second = "clock[s];T[degC];date\n" + "".join(f"{a:.9g};{b:.9g};{d}\n" for a, b, d in zip(later, theta, others, strict=True))
    (tmp_path / "sensor.csv").write_text(second, encoding="utf-8")
    got = record(tmp_path, text, temperature={"column": "T[degC]", "file": "sensor.csv", "offset_s": "dates"})
    assert got.temperature is not None
    np.testing.assert_allclose(got.temperature, 293.15 + 0.1 * (got.time + 12.5), atol=1e-4 if header else 1e-3)
    said = next(remark for remark in got.remarks if "by the dates of both" in remark)
    assert said.endswith("which hold to 0 s" if header else "which hold to 0.95 s")
    (tmp_path / "sensor.csv").write_text(table("clock[s],T[degC]", [later, theta]), encoding="utf-8")
    with pytest.raises(
        StudyError, match=r"temperature.date' is missing, and .* has 0 columns of dates and no start of the test in its header"
    ):
        record(tmp_path, text, temperature={"column": "T[degC]", "file": "sensor.csv", "offset_s": "dates"})


def test_a_column_of_dates_may_be_the_clock(tmp_path: Path, cyclic: tuple[np.ndarray, ...]) -> None:
    t, e, s, _ = cyclic
    began = dt.datetime(2021, 6, 30, 23, 59, 30)
    stamps = [f"{began + dt.timedelta(seconds=float(x)):%Y-%m-%d %H:%M:%S.%f}" for x in t]
    text = "when,e[-],s[MPa]\n" + "".join(f"{d},{b:.9g},{c:.9g}\n" for d, b, c in zip(stamps, e, s, strict=True))
    got = record(tmp_path, text, time="when")
    np.testing.assert_allclose(got.time, t, atol=1e-5)
    assert "time counted from the first date, 2021-06-30 23:59:30" in got.remarks


def test_a_straight_line_fits_at_any_offset_and_is_refused() -> None:
    t = np.arange(0.0, 100.0, 0.1)
    with pytest.raises(DataError, match="give offset_s"):
        clock_offset((t, 3.0 * t), (t[:700] + 11.0, 5.0 * t[:700]))
