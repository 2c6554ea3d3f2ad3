"""The chain: which stages run, what a doubtful one does, and the final table. The stages are small stand-ins."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from thermofit.core.errors import NumericsError, StudyError
from thermofit.records.artefact import ParameterResult, RecordContent, write_record
from thermofit.records.staging import Outcome, artefact_path
from thermofit.stages.run import Link, Selection, chain, selected, summary_of, table
from thermofit.study.study import Study, load_study

NAMES = (
    "simulate", "calibrate-ir", "interpolate", "identify-elastic", "identify-plastic", "identify-thermal",
    "gridsearch", "sensitivity", "verify", "report",
)  # fmt: skip
FREE = {
    "identify-elastic": {"nu": 0.347, "E": 69000.0},
    "identify-plastic": {"H_lin": 12.0, "M_y0": 129.0},
    "identify-thermal": {"c0": 2.2},
}
STUDY = """
name: tiny
parameters: {E: 60000, nu: 0.3, M_y0: 140, M_yinf: 290, H_exp: 15, F: 0.5, H_lin: 10, c0: 2.4, theta_air: 297.4, theta_clamp: 296.7}
stages:
  elastic: {free: [E, nu]}
  plastic: {free: [M_y0, H_lin]}
  thermal: {free: [c0]}
"""
TRUTH = "simulate: {truth: {E: 68000, M_y0: 130, c0: 2.2, theta_air: 297.4, theta_clamp: 296.7}}\n"


@pytest.fixture(autouse=True)
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """How often the kernels of a body were asked for; the stages here call none."""
    calls: list[str] = []
    monkeypatch.setattr("thermofit.experiment.body.compiled", lambda: calls.append("body"))
    return calls


def parameter(value: float, free: bool = True) -> ParameterResult:
    return ParameterResult(value, 0.01 * value, "MPa", free, False, 1.1 * value, 0.0, 1e9)


def study_of(folder: Path, text: str = STUDY + TRUTH) -> Study:
    path = folder / "study.yaml"
    path.write_text(text, encoding="utf-8")
    return load_study(path, [f"run_dir={folder / 'run'}"])


def measured(folder: Path, infrared: bool) -> Study:
    raw = folder / "raw"
    (raw / "ir" if infrared else raw).mkdir(parents=True)
    return study_of(folder, STUDY + TRUTH + "experiment: raw\n")


def links(calls: list[str], summaries: dict[str, dict[str, Any]] | None = None, infrared: bool = True) -> list[Link]:
    def link(name: str) -> Link:
        def run(study: Study, *, force: bool = False) -> Outcome:
            calls.append(name)
            if name == "simulate":
                (study.experiment / "ir" if infrared else study.experiment).mkdir(parents=True)
            return write(study, name, (summaries or {}).get(name, {}))

        return Link(name, run)

    return [link(name) for name in NAMES]


def write(study: Study, name: str, summary: dict[str, Any]) -> Outcome:
    parameters = {n: parameter(v) for n, v in FREE.get(name, {}).items()} | {"kappa": parameter(150.0, free=False)}
    path = artefact_path(study.run_dir, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    full = {"verdict": f"{name} ok", "evaluations": {"forward": 3, "failed": 1, "wall_s": 0.5}, **summary}
    return Outcome(write_record(path, RecordContent(name, {}, {}, {}, parameters, full)), False)


def without(names: Sequence[str]) -> list[str]:
    return [name for name in NAMES if name not in names]


def test_selection() -> None:
    costly = ("gridsearch", "sensitivity")
    assert list(selected(NAMES, Selection())) == without(costly)
    assert selected(NAMES, Selection(everything=True)) == NAMES
    assert selected(NAMES, Selection("identify-plastic", "verify")) == ("identify-plastic", "identify-thermal", "verify")
    assert selected(NAMES, Selection("gridsearch", "verify")) == ("gridsearch", "verify"), "named: wanted"
    assert selected(NAMES, Selection("report", "report")) == ("report",)


@pytest.mark.parametrize(
    ("selection", "words"),
    [
        (Selection("verifi"), "did you mean 'verify'"),
        (Selection(last="all"), "--until all: there is no such stage"),
        (Selection("verify", "interpolate"), "comes before"),
    ],
)
def test_selection_that_is_none(selection: Selection, words: str) -> None:
    with pytest.raises(StudyError, match=words):
        selected(NAMES, selection)


def test_virtual_experiment_runs_everything_but_the_costly_stages(tmp_path: Path) -> None:
    calls: list[str] = []
    told: list[str] = []
    steps = chain(study_of(tmp_path), links(calls), Selection(), report=lambda result: told.append(result["stage"]))
    assert calls == told == [step.name for step in steps] == without(("gridsearch", "sensitivity"))


def test_infrared_is_looked_for_after_simulate_has_made_the_folder(tmp_path: Path) -> None:
    calls: list[str] = []
    steps = chain(study_of(tmp_path), links(calls, infrared=False), Selection())
    assert calls == without(("calibrate-ir", "identify-thermal", "gridsearch", "sensitivity"))
    assert {step.name: step.skipped for step in steps if step.skipped} == dict.fromkeys(
        ("calibrate-ir", "identify-thermal"), "the experiment has no infrared frames"
    )


def test_measured_experiment_is_not_simulated(tmp_path: Path) -> None:
    calls: list[str] = []
    steps = chain(measured(tmp_path, True), links(calls), Selection(everything=True))
    assert calls == without(("simulate", "gridsearch", "sensitivity")), "the study has no section gridsearch nor sensitivity"
    assert [step.name for step in steps if step.skipped] == ["simulate", "gridsearch", "sensitivity"]


def test_doubtful_stage_does_not_end_the_chain(tmp_path: Path) -> None:
    calls: list[str] = []
    study = study_of(tmp_path)
    summaries = {"identify-plastic": {"trustworthy": False, "verdict": "M_y0 is at its bound"}}
    summary = summary_of(study, chain(study, links(calls, summaries), Selection()))
    assert calls[-2:] == ["verify", "report"]
    assert summary["trustworthy"] is False
    assert summary["verdict"] == "identify-plastic: M_y0 is at its bound"


def test_error_ends_the_chain(tmp_path: Path) -> None:
    calls: list[str] = []
    made = links(calls)

    def fails(study: Study, *, force: bool = False) -> Outcome:
        raise NumericsError("no convergence")

    made[2] = Link("interpolate", fails)
    with pytest.raises(NumericsError):
        chain(study_of(tmp_path), made, Selection())
    assert calls == ["simulate", "calibrate-ir"]


def test_table_is_in_the_order_of_the_study_beside_the_truth(tmp_path: Path) -> None:
    study = study_of(tmp_path)
    rows = table(study, [write(study, name, {}).record for name in FREE])
    assert [row.name for row in rows] == ["E", "nu", "M_y0", "H_lin", "c0"], "kappa was not free"
    by_name = {row.name: row for row in rows}
    assert by_name["E"].deviation == pytest.approx(69000.0 / 68000.0 - 1.0)
    assert (by_name["nu"].true, by_name["nu"].start) == (0.33, pytest.approx(1.1 * 0.347)), "what the truth leaves out is neutral"
    assert (by_name["H_lin"].true, by_name["H_lin"].deviation) == (0.0, None), "no deviation relative to zero"


def test_table_without_truth(tmp_path: Path) -> None:
    (tmp_path / "raw").mkdir()
    study = study_of(tmp_path, STUDY + "experiment: raw\n")
    rows = table(study, [write(study, "identify-elastic", {}).record])
    assert [(row.true, row.deviation) for row in rows] == [(None, None)] * 2


def test_summary_takes_earlier_stages_from_disk_and_later_ones_not(tmp_path: Path) -> None:
    study = study_of(tmp_path)
    chain(study, links([]), Selection())
    later = summary_of(study, chain(study, links([]), Selection("verify", "verify")))
    assert [row["name"] for row in later["table"]] == ["E", "nu", "M_y0", "H_lin", "c0"]
    assert later["evaluations"] == {"forward": 9, "failed": 3, "wall_s": 1.5}
    plastic = summary_of(study, chain(study, links([]), Selection("identify-plastic", "identify-plastic")))
    assert [row["name"] for row in plastic["table"]] == ["E", "nu", "M_y0", "H_lin"]
    assert set(plastic["parameters"]) == {"E", "nu", "M_y0", "H_lin"}
    early = summary_of(study, chain(study, links([]), Selection("interpolate", "interpolate")))
    assert early["table"] == [] and early["parameters"] == {}


def test_summary_lists_the_pictures(tmp_path: Path) -> None:
    study = study_of(tmp_path)
    summaries = {"calibrate-ir": {"picture": "a.png"}, "report": {"figures": ["b.png", "c.png"]}}
    summary = summary_of(study, chain(study, links([], summaries), Selection()))
    assert summary["figures"] == ["a.png", "b.png", "c.png"]
    assert summary["verdict"].startswith("8 stages done (") and summary["verdict"].endswith("verify: verify ok")


@pytest.mark.parametrize(("last", "times"), [("interpolate", 0), ("identify-elastic", 1)])
def test_kernels_are_compiled_before_the_first_stage_that_runs_a_model(tmp_path: Path, asked: list[str], last: str, times: int) -> None:
    chain(measured(tmp_path, infrared=True), links([]), Selection("calibrate-ir", last))
    assert len(asked) == times
