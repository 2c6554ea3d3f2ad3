"""Questions before an identification: a good test is never asked about, every planted mistake is, with its mend."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seen_test import SPECIMEN, pose_at, pulled, watched, write_raw
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.core.errors import DataError
from thermofit.core.experiment import CELSIUS, CouponRecord, MeasuredTest
from thermofit.observe.camera_motion import seen_across
from thermofit.read.plausible import Question, asked, first_look, questions_of_record, questions_of_test, settled
from thermofit.read.ranges import RANGES, Doubt

GOOD = watched(pulled(70e3, 150.0))
POSE = pose_at()


def words(questions: tuple[Question, ...]) -> str:
    return "\n".join(f"{q.name} {q.nonsense} {q.text}" for q in questions)


@settings(max_examples=40, deadline=None)
@given(
    modulus=st.floats(15e3, 420e3),
    share=st.floats(8e-4, 8e-3),
    rate=st.floats(2e-5, 10.0),
    width=st.floats(3.0, 60.0),
    thickness=st.floats(0.3, 5.0),
    air=st.floats(263.0, 318.0),
)
def test_a_good_test_is_never_asked_about(modulus: float, share: float, rate: float, width: float, thickness: float, air: float) -> None:
    made = pulled(modulus, max(share * modulus, 15.0), rate=rate)
    assert made.dic is not None
    k = width / SPECIMEN.gauge_width
    lengths = {"gauge_width": width, "thickness": thickness, "parallel_length": k * 80.0, "grip_width": k * 30.0, "total_length": k * 120.0}
    dic = replace(made.dic, reference=k * made.dic.reference, displacement=k * made.dic.displacement)
    force = replace(made.force, force=made.force.force * width * thickness / 30.0)
    good = replace(made, specimen=replace(SPECIMEN, **lengths), dic=dic, force=force, theta_air=air, theta_clamp=air - 0.7)
    assert not questions_of_test(good), words(questions_of_test(good))


@pytest.mark.parametrize("side", ["front", "back"])
def test_nor_is_one_with_an_infrared_camera(side: str) -> None:
    good = watched(pulled(70e3, 150.0), side)
    assert not questions_of_test(good, pose_at(side)), words(questions_of_test(good, pose_at(side)))


def moved(e: MeasuredTest, factor: float, place: float = 1.0) -> MeasuredTest:
    assert e.dic is not None
    return replace(e, dic=replace(e.dic, displacement=factor * e.dic.displacement, reference=place * e.dic.reference))


def clocks(e: MeasuredTest, factor: float, force: float | None = None) -> MeasuredTest:
    assert e.dic is not None and e.ir is not None
    own = replace(e.force, time=e.force.time * (factor if force is None else force))
    return replace(e, force=own, dic=replace(e.dic, time=factor * e.dic.time), ir=replace(e.ir, time=factor * e.ir.time))


def lengths(e: MeasuredTest, **own: float) -> MeasuredTest:
    return replace(e, specimen=replace(e.specimen, **own))


def frames(e: MeasuredTest, shift: float, factor: float = 1.0) -> MeasuredTest:
    assert e.ir is not None
    return replace(e, ir=replace(e.ir, frames=factor * e.ir.frames + shift))


def exchanged(e: MeasuredTest) -> MeasuredTest:
    assert e.dic is not None
    axes = [1, 0, 2]
    return replace(e, dic=replace(e.dic, displacement=e.dic.displacement[:, :, axes], reference=e.dic.reference[:, axes]))


def shifted(e: MeasuredTest) -> MeasuredTest:
    assert e.dic is not None
    return replace(e, dic=replace(e.dic, reference=e.dic.reference + np.array([40.0, 60.0, 0.0])))


def placed(e: MeasuredTest, x: float, y: float) -> MeasuredTest:
    assert e.dic is not None
    return replace(e, dic=replace(e.dic, reference=e.dic.reference * np.array([x, y, 1.0])))


def twice(e: MeasuredTest) -> MeasuredTest:
    assert e.dic is not None
    ids, place = np.arange(2 * len(e.dic.point_id)), np.vstack([e.dic.reference, e.dic.reference])
    return replace(e, dic=replace(e.dic, point_id=ids, reference=place, displacement=np.concatenate([e.dic.displacement] * 2, axis=1)))


MISTAKES: dict[str, tuple[Callable[[MeasuredTest], MeasuredTest], str, str]] = {
    "force in kN": (lambda e: replace(e, force=replace(e.force, force=1e-3 * e.force.force)), "force", "force in kN under a header in N"),
    "force sign": (lambda e: replace(e, force=replace(e.force, force=-e.force.force)), "force", "sign of the force"),
    "no force": (lambda e: replace(e, force=replace(e.force, force=0.0 * e.force.force)), "force", "0 N from beginning to end"),
    "constant force": (
        lambda e: replace(e, force=replace(e.force, force=0.0 * e.force.force + 812.0)),
        "force",
        "812 N from beginning to end",
    ),
    "force is noise": (
        lambda e: replace(e, force=replace(e.force, force=np.random.default_rng(2).normal(size=len(e.force.time)))),
        "force",
        "the load cell saw no test",
    ),
    "times in ms": (lambda e: clocks(e, 1e3), "time", "are the times in ms"),
    "force clock in ms": (lambda e: clocks(e, 1.0, 1e3), "time", "is the force in ms"),
    "frames in K": (lambda e: frames(e, CELSIUS), "temperature", "the frames in K"),
    "frames in mK": (lambda e: frames(e, 0.0, 1e3), "temperature", "are they temperatures in degC"),
    "air in K": (lambda e: replace(e, theta_air=e.theta_air + CELSIUS), "temperature", "is the first one in K"),
    "air and jaws in K": (
        lambda e: replace(e, theta_air=e.theta_air + CELSIUS, theta_clamp=e.theta_clamp + CELSIUS),
        "temperature",
        "the temperatures of air and jaws in K",
    ),
    "thickness in m": (lambda e: lengths(e, thickness=1.5e-3), "specimen", "is it in m"),
    "width in m": (lambda e: lengths(e, gauge_width=0.02), "specimen", "is it in m"),
    "thick plate in m": (
        lambda e: replace(lengths(e, thickness=0.012), force=replace(e.force, force=8.0 * e.force.force)),
        "force",
        "the thickness in m",
    ),
    "width and thickness exchanged": (
        lambda e: lengths(e, gauge_width=1.5, thickness=20.0, grip_width=2.0),
        "place",
        "width and thickness exchanged",
    ),
    "displacements in m": (lambda e: moved(e, 1e-3), "displacement", "the displacements in m"),
    "displacements in um": (lambda e: moved(e, 1e3), "displacement", "the displacements in um"),
    "DIC in m": (lambda e: moved(e, 1e-3, 1e-3), "place", "is the DIC field in m"),
    "DIC in um": (lambda e: moved(e, 1e3, 1e3), "place", "is the DIC field in um"),
    "axes exchanged": (exchanged, "place", "are x and y exchanged"),
    "origin in a corner": (shifted, "place", "where is the origin"),
    "points at one place": (lambda e: placed(e, 0.0, 0.0), "place", "lie exactly where another one lies"),
    "points twice": (lambda e: twice(e), "place", "lie exactly where another one lies"),
    "one coordinate lost": (lambda e: placed(e, 1e-9, 1.0), "place", "lie on one line"),
    "mirrored frames": (lambda e: watched(e, "front"), "side", "camera's x is mirrored"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_refused_with_its_mend(mistake: str) -> None:
    plant, name, text = MISTAKES[mistake]
    asked_about = [q for q in questions_of_test(plant(GOOD), POSE) if q.nonsense]
    assert any(q.name == name and text in q.text for q in asked_about), words(tuple(asked_about))


def without_displacements(**own: object) -> MeasuredTest:
    """The good test as load cell and infrared camera saw it."""
    return replace(GOOD, dic=None, **own)


def test_temperatures_without_displacements_are_asked_about_as_well() -> None:
    """A good one never; force, lengths and clock by the largest stress and the frames alone."""
    good = without_displacements()
    assert not questions_of_test(good, POSE), words(questions_of_test(good, POSE))
    record = GOOD.force
    small = questions_of_test(without_displacements(force=replace(record, force=1e-3 * record.force)))
    assert [(q.name, q.nonsense) for q in small] == [("force", True)] and "the force in kN under a header in N" in small[0].text
    (slow,) = questions_of_test(without_displacements(force=replace(record, time=1e3 * record.time)))
    assert (slow.name, slow.nonsense) == ("time", True) and "the infrared frames" in slow.text
    (pushed,) = questions_of_test(without_displacements(force=replace(record, force=-record.force)))
    assert (pushed.name, pushed.nonsense) == ("force", False) and "a compression test" in pushed.text


def test_what_cannot_be_decided_is_a_remark() -> None:
    """All temperatures alike in K may be a furnace; a slow test without a camera may be slow; a crosshead in m is not used."""
    furnace = frames(replace(GOOD, theta_air=GOOD.theta_air + CELSIUS, theta_clamp=GOOD.theta_clamp + CELSIUS), CELSIUS)
    remarks = asked(furnace)
    assert any("a hot test, or a temperature in K" in text for text in remarks)
    slow = replace(clocks(GOOD, 1e3), ir=None)
    assert any("are the times in s?" in text for text in asked(slow))
    assert GOOD.dic is not None
    crosshead = np.linspace(0.0, 0.024, len(GOOD.force.time))
    travelled = replace(GOOD, force=replace(GOOD.force, crosshead=1e-3 * crosshead))
    assert any("is the column crosshead_mm in mm?" in text for text in asked(travelled))


def test_a_confirmed_question_is_not_asked_again() -> None:
    wrong = MISTAKES["force in kN"][0](GOOD)
    with pytest.raises(DataError, match="confirmed: \\[force\\]"):
        asked(wrong)
    assert asked(replace(wrong, confirmed=("force",))) == ()


@pytest.mark.parametrize(("side", "slope"), [("back", 1.0), ("front", -1.0)])
def test_the_sideways_motion_tells_the_side(side: str, slope: float) -> None:
    assert GOOD.ir is not None and GOOD.dic is not None
    found = seen_across(pose_at(side), GOOD.ir, GOOD.dic, GOOD.specimen)
    assert found is not None and abs(found.slope - slope) < 4.0 * found.sigma < 0.5


def test_a_specimen_that_does_not_move_sideways_tells_no_side() -> None:
    still = watched(pulled(70e3, 150.0, drift=0.0), "front")
    assert not [q for q in questions_of_test(still, POSE) if q.name == "side"]


def test_a_missing_stage_and_a_missing_frame_are_told(tmp_path: Path) -> None:
    write_raw(tmp_path / "raw", GOOD)
    for name in ("dic/stage_0017.csv", "ir/frame_0005.csv"):
        (tmp_path / "raw" / name).unlink()
    result = CliRunner().invoke(app, ["inspect", str(tmp_path / "raw"), "--json"])
    found = json.loads(result.stdout)
    assert result.exit_code == 0 and "ready for a study" in found["verdict"]
    assert any("1 stages are missing between number 0 and 40: 17" in remark for remark in found["remarks"])
    assert any("1 frames are missing" in remark for remark in found["remarks"])


def test_inspect_and_new_refuse_what_makes_no_sense(tmp_path: Path) -> None:
    raw, study = tmp_path / "raw", tmp_path / "study.yaml"
    write_raw(raw, MISTAKES["force in kN"][0](GOOD))
    seen = CliRunner().invoke(app, ["inspect", str(raw), "--json"])
    found = json.loads(seen.stdout)
    assert seen.exit_code == 3 and not found["trustworthy"] and "force in kN" in found["verdict"]
    made = CliRunner().invoke(app, ["new", str(study), "--experiment", str(raw)])
    assert made.exit_code == 3 and "force_kN" in made.output and not study.exists()
    with pytest.raises(DataError, match="force_kN"):
        first_look(raw)


@pytest.mark.parametrize("mistake", ["points at one place", "points twice", "one coordinate lost", "no force", "constant force"])
def test_a_field_without_places_or_a_force_without_change_ends_in_a_sentence(tmp_path: Path, mistake: str) -> None:
    """By the command line, too, where noise and spacing are asked of what has none; within seconds of the processor."""
    raw = tmp_path / "raw"
    write_raw(raw, replace(MISTAKES[mistake][0](GOOD), ir=None, landmarks=None))
    begin = process_time()
    result = CliRunner().invoke(app, ["inspect", str(raw)])
    assert result.exit_code == 3 and "not ready for a study" in " ".join(result.output.split()), result.output
    assert CliRunner().invoke(app, ["new", str(tmp_path / "study.yaml"), "--experiment", str(raw)]).exit_code == 3
    assert process_time() - begin < 20.0


def record(factor_strain: float = 1.0, factor_stress: float = 1.0, time: float = 60.0, **more: object) -> CouponRecord:
    """A coupon of steel pulled to 8 %."""
    strain = np.r_[np.linspace(0.0, 0.002, 40, endpoint=False), np.linspace(0.002, 0.08, 60)]
    stress = np.where(strain < 0.0019, 2e5 * strain, 380.0 + 900.0 * (strain - 0.0019))
    made = CouponRecord("a", np.linspace(0.0, time, 100), factor_strain * strain, factor_stress * stress, None, 296.0)
    return replace(made, **more)  # type: ignore[arg-type]


def heated(time: float, start: float = 296.0) -> np.ndarray:
    return start + 4.0 * np.linspace(0.0, 1.0, 100) * (time > 0.0)


def test_a_good_record_is_never_asked_about() -> None:
    for made in (record(), record(temperature=heated(60.0)), record(time=2.0), record(time=1e4)):
        assert not questions_of_record(made), words(questions_of_record(made))


@pytest.mark.parametrize(
    ("wrong", "name", "text", "nonsense"),
    [
        (record(factor_strain=100.0), "strain", "the strain in percent", True),
        (record(factor_strain=1e6), "strain", "the strain in millionths", True),
        (record(factor_stress=1e6), "stress", "the stress in Pa", True),
        (record(factor_stress=1e-3), "stress", "the force in kN", True),
        (record(time=6e4, temperature=heated(6e4)), "time", "are the times in ms", True),
        (record(time=6e6), "time", "are the times in s?", False),
        (record(temperature=heated(60.0, 296.0 + CELSIUS), theta_start=296.0), "temperature", "is one of them in K", True),
        (record(temperature=heated(60.0, 296.0 + CELSIUS), theta_start=296.0 + CELSIUS), "temperature", "is it a hot test", False),
        (record(temperature=heated(60.0, 2.96e5)), "temperature", "which is no specimen", True),
    ],
)
def test_a_wrong_record_is_asked_about(wrong: CouponRecord, name: str, text: str, nonsense: bool) -> None:
    found = questions_of_record(wrong)
    assert any(q.name == name and text in q.text and q.nonsense is nonsense for q in found), words(found)


def test_a_record_in_heat_or_of_flow_alone_has_no_elastic_line() -> None:
    soft = record(factor_stress=0.04)
    assert any("elastic slope" in q.text and not q.nonsense for q in questions_of_record(soft))
    assert not any("slope" in q.text for q in questions_of_record(replace(soft, theta_start=1100.0)))


def test_a_wrong_record_ends_its_study(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"records/a\.csv: .*percent"):
        settled(questions_of_record(record(factor_strain=100.0)), (), "records/a.csv")


def test_every_question_is_explained() -> None:
    text = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
    assert not [name for name in get_args(Doubt) if f"`{name}`" not in text]
    assert not [name for name, known in RANGES.items() if not known.possible[0] <= known.usual[0] < known.usual[1] <= known.possible[1]]
