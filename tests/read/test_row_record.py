"""The table of a strip: places in any order, lost values counted, sections as means; and what is wrong in a file or a study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from thermofit.core.errors import DataError, StudyError
from thermofit.read.row import read_axial_table, row_record
from thermofit.study.coupon import RowSettings
from thermofit.study.study import load_study

TIME = np.arange(24) * 0.05
PLACE = np.arange(-6.0, 6.5, 0.5)
FIELD = TIME[:, None] * (0.2 - 0.002 * PLACE**2)


def write(path: Path, order: np.ndarray | None = None, field: np.ndarray = FIELD, lost: float = np.nan, separator: str = ",") -> Path:
    order = np.arange(len(PLACE)) if order is None else order
    lines = [separator.join(["Element", *(f"{PLACE[k]:g}" for k in order)])]
    for t, row in zip(TIME, field, strict=True):
        lines.append(separator.join([f"{t:g}", *("???" if np.isnan(row[k]) else f"{row[k]:.9g}" for k in order)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def entry(**changes: Any) -> RowSettings:
    return RowSettings.model_validate(
        {"file": "a.csv", "strain": "nominal", "places": {"from": -4, "to": 4, "every": 2}, "temperature_degC": 450, **changes}
    )


@given(order=st.permutations(range(len(PLACE))), seed=st.integers(0, 99))
@settings(max_examples=25, deadline=None)
def test_places_may_stand_in_any_order_and_lost_values_are_counted(
    tmp_path_factory: pytest.TempPathFactory, order: list[int], seed: int
) -> None:
    lost = np.random.default_rng(seed).random(FIELD.shape) < 0.05
    path = write(tmp_path_factory.mktemp("row") / "a.csv", np.array(order), np.where(lost, np.nan, FIELD))
    table = read_axial_table(path)
    assert np.array_equal(table.place, PLACE) and np.allclose(table.time, TIME)
    assert table.lost == lost.sum() and np.allclose(table.strain[~lost], FIELD[~lost])


def test_a_section_is_the_mean_of_the_points_near_it(tmp_path: Path) -> None:
    write(tmp_path / "a.csv")
    found = row_record(entry(), tmp_path, "coupon.rows.0")
    assert np.array_equal(found.place, [-4.0, -2.0, 0.0, 2.0, 4.0])
    near = (PLACE >= -3.0) & (PLACE < -1.0)
    assert near.sum() == 4 and np.allclose(found.strain[:, 1], FIELD[:, near].mean(axis=1))
    true = row_record(entry(strain="logarithmic"), tmp_path, "coupon.rows.0")
    assert np.allclose(true.strain[:, 1], np.expm1(FIELD[:, near]).mean(axis=1)), "nominal strain of logarithmic one"


def test_noise_is_that_of_the_means_and_lost_values_are_bridged(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    field = FIELD + 1e-3 * rng.normal(size=FIELD.shape)
    field[5, np.abs(PLACE) < 1.2] = np.nan
    write(tmp_path / "a.csv", field=field)
    found = row_record(entry(), tmp_path, "coupon.rows.0")
    assert found.noise == pytest.approx(5e-4, rel=0.3), "of four points each"
    assert found.strain[5, 2] == pytest.approx(0.5 * (found.strain[4, 2] + found.strain[6, 2]), rel=1e-6)
    for row, column in ((0, 0), (-1, 4)):  # at an end the course goes on, it does not stop
        field = FIELD.copy()
        field[row, np.abs(PLACE - found.place[column]) < 1.2] = np.nan
        write(tmp_path / "b.csv", field=field)
        ended = row_record(entry(file="b.csv"), tmp_path, "coupon.rows.0")
        whole = row_record(entry(file="c.csv"), tmp_path, "coupon.rows.0") if write(tmp_path / "c.csv") else found
        assert np.allclose(ended.strain, whole.strain, atol=1e-12)
    assert any("5 of 600 values are lost" in text for text in found.remarks) and any(
        "1 lost values of sections" in t for t in found.remarks
    )


def test_means_over_time_keep_a_straight_course(tmp_path: Path) -> None:
    write(tmp_path / "a.csv")
    found = row_record(entry(points=11), tmp_path, "coupon.rows.0")
    assert len(found.time) == 11 and np.allclose(found.time, TIME.reshape(12, 2).mean(axis=1)[1:]), "not where the strip begins to flow"
    assert np.allclose(found.strain[:, 2] / found.time, found.strain[3, 2] / found.time[3])


def test_the_record_ends_at_the_largest_strain(tmp_path: Path) -> None:
    write(tmp_path / "a.csv")
    found = row_record(entry(strain_max=0.15), tmp_path, "coupon.rows.0")
    assert found.strain.max() <= 0.15 < FIELD.max()
    assert row_record(entry(window=[0.2, 0.9]), tmp_path, "coupon.rows.0").time[0] == pytest.approx(0.2)


def changed(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: changed(t, ",-5.5,", ",left,"), "row 1, column 3: 'left' is no place; expected a number in mm"),
        (lambda t: changed(t, ",-5.5,", ",-6,"), "row 1: place -6 mm stands twice"),
        (lambda t: changed(t, "\n0.1,", "\nsoon,"), "row 4: 'soon' is no time"),
        (lambda t: changed(t, "\n0.1,", "\n0.05,"), "row 4: time 0.05 s follows 0.05 s; expected increasing times"),
        (lambda t: "\n".join(t.splitlines()[:2]), "found 2 rows; expected places in the first row"),
    ],
)
def test_what_is_wrong_in_the_file_is_named(tmp_path: Path, change: Any, says: str) -> None:
    path = write(tmp_path / "a.csv")
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(DataError, match=says):
        read_axial_table(path)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"places": {"from": -40, "to": 4, "every": 2}}, "no point lies within 1 mm of the section at -40 mm; places are -6 to 6 mm"),
        ({"window": [0.0, 0.2]}, "5 rows lie within 'window' and 'strain_max'; expected ten at least"),
    ],
)
def test_what_an_entry_asks_and_the_file_does_not_hold(tmp_path: Path, changes: dict[str, Any], says: str) -> None:
    write(tmp_path / "a.csv")
    with pytest.raises(DataError, match=says):
        row_record(entry(**changes), tmp_path, "coupon.rows.0")


def test_a_section_that_lost_too_much_is_refused(tmp_path: Path) -> None:
    field = FIELD.copy()
    field[10:, (PLACE >= 3.0) & (PLACE < 5.0)] = np.nan
    write(tmp_path / "a.csv", field=field)
    with pytest.raises(DataError, match="section at 4 mm has 10 of 24 values; expected 80% at least"):
        row_record(entry(), tmp_path, "coupon.rows.0")


def study(tmp_path: Path, coupon: dict[str, Any], **changes: Any) -> Any:
    parameters = {"E": 50e3, "M_y0": 40.0, "M_yinf": {"start": 90.0}, "H_exp": {"start": 5.0}}
    tree = {"name": "row", "run_dir": str(tmp_path / "run"), "parameters": parameters, "coupon": coupon, **changes}
    (tmp_path / "row.yaml").write_text(yaml.safe_dump(tree), encoding="utf-8")
    return load_study(tmp_path / "row.yaml")


ROW = {"file": "a.csv", "strain": "nominal", "places": {"from": -4, "to": 4, "every": 2}, "temperature_degC": 450}


@pytest.mark.parametrize(
    ("coupon", "says"),
    [
        ({"rows": [{**ROW, "strian": "nominal"}]}, r"'coupon\.rows\.0\.strian' is not known; did you mean 'strain'"),
        ({"rows": [{**ROW, "places": {"form": -4, "to": 4, "every": 2}}]}, "did you mean 'from'"),
        ({"rows": [{**ROW, "places": {"from": -4, "to": -2, "every": 2}}]}, "expected three sections at least"),
        ({"rows": [{**ROW, "area": [1.0, 1.0]}]}, "has 2 values for 5 places"),
        ({"rows": [{k: v for k, v in ROW.items() if k != "strain"}]}, r"coupon\.rows\.0\.strain"),
        ({"rows": [ROW], "control": "stress"}, "is stress; expected mean-strain for rows"),
        ({"rows": [ROW, ROW]}, "is 'a' again"),
        ({"rows": [{**ROW, "held_out": True}]}, "are all held out"),
        ({"rows": [ROW], "heat": "measured-work"}, "a row has no measured stress"),
        ({"rows": [ROW], "records": [{"file": "b.csv", "time": "t", "strain": "e", "stress": "s"}]}, "are given beside records"),
    ],
)
def test_what_is_wrong_in_the_study_is_named(tmp_path: Path, coupon: dict[str, Any], says: str) -> None:
    with pytest.raises(StudyError, match=says):
        study(tmp_path, coupon)


def test_without_a_force_the_scale_of_the_stress_is_prescribed(tmp_path: Path) -> None:
    found = study(tmp_path, {"rows": [ROW]})
    assert found.stage("plastic").free == ("M_yinf", "H_exp") and found.stage("elastic").free == ()
    assert tuple(found.stage("plastic").channels) == ("strain",)
    free = {"M_y0": {"start": 40.0}, "M_yinf": {"start": 90.0}, "H_exp": {"start": 5.0}, "E": 50e3}
    with pytest.raises(StudyError, match="the scale of the stress is not determined: give one of them, such as M_y0, as a number"):
        study(tmp_path, {"rows": [ROW]}, parameters=free).stage("plastic")
    with pytest.raises(StudyError, match="holds E, which strains without a force do not tell"):
        study(tmp_path, {"rows": [ROW]}, parameters={**free, "E": {"start": 5e4}}, stages={"plastic": {"free": ["E", "M_yinf"]}}).stage(
            "plastic"
        )
