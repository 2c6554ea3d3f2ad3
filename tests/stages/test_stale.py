"""Results that no longer follow from their data or their study are refused or told; those of a copied folder are read where they lie."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import verify_fixtures as made
import yaml
from typer.testing import CliRunner

from thermofit.body.solve.march import History
from thermofit.cli.app import app
from thermofit.core.errors import StudyError
from thermofit.diagnose.prepared import diagnosis_job
from thermofit.identify.outcome import parameter_results
from thermofit.identify.stage import ready
from thermofit.records.artefact import open_record, write_record
from thermofit.records.result import description_of, result_of
from thermofit.records.staging import Job, artefact_path
from thermofit.stages import interpolate, report, simulate, verify
from thermofit.study.study import Study, load_study

ALL = ("identify-elastic", "identify-plastic", "identify-thermal")


@pytest.fixture(scope="module")
def history() -> History:
    return made.coupled_run()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, history: History) -> Path:
    """Folder of a study and of its run, verified and reported; every record knows the digests of its inputs."""
    folder = tmp_path_factory.mktemp("finished")
    study = made.study_in(folder)
    made.write_all(study, made.interpolated(history))
    inputs = {"interpolate": artefact_path(study.run_dir, "interpolate")}
    for name in ALL:
        content = made.identified(name, made.TRUTH)
        current = ready(study, name.removeprefix("identify-")).config
        made.write_all(study, replace(content, inputs=dict(inputs), config=current))
        inputs[name] = artefact_path(study.run_dir, name)
    verify.run(study)
    report.run(study)
    return folder


@pytest.fixture
def folder(finished: Path, tmp_path: Path) -> Path:
    """A copy of it that a test may change; the run folder is `folder/run`."""
    shutil.copytree(finished, tmp_path / "copy")
    return tmp_path / "copy"


def study_of(folder: Path, *overrides: str) -> Study:
    return load_study(folder / "study.yaml", [f"run_dir={folder / 'run'}", *overrides])


def interpolate_anew(folder: Path, history: History) -> None:
    made.write_all(study_of(folder), made.interpolated(history))


def test_verify_refuses_an_identification_from_other_data(folder: Path, history: History) -> None:
    interpolate_anew(folder, history)
    with pytest.raises(StudyError) as caught:
        verify.run(study_of(folder))
    text = str(caught.value)
    assert "identify-elastic.h5 is stale: interpolate.h5 has changed since" in text
    assert "`thermofit run study.yaml --until identify-elastic`" in text and "\n" not in text


def test_the_next_stage_refuses_an_earlier_one_from_other_data(folder: Path, history: History) -> None:
    interpolate_anew(folder, history)
    with pytest.raises(StudyError, match=r"identify-elastic\.h5 is stale"):
        ready(study_of(folder), "plastic")


def test_report_of_stale_results_says_so_and_is_not_green(folder: Path, history: History) -> None:
    assert report.run(study_of(folder)).record.summary.get("trustworthy") is not False
    interpolate_anew(folder, history)
    record = report.run(study_of(folder)).record
    assert record.summary["trustworthy"] is False
    assert "identify-elastic.h5: interpolate.h5 has changed since" in record.summary["verdict"]
    text = (folder / "run" / "report.md").read_text(encoding="utf-8")
    assert "Stale results" in text and "verify.h5: interpolate.h5 has changed since" in text


@pytest.mark.parametrize("stage", [*ALL, "verify", "report"])
def test_show_says_what_is_stale(folder: Path, history: History, stage: str) -> None:
    path = folder / "run" / f"{stage}.h5"
    assert description_of(open_record(path))["stale"] == []
    interpolate_anew(folder, history)
    assert "interpolate.h5 has changed since" in description_of(open_record(path))["stale"]
    shown = CliRunner().invoke(app, ["show", str(path)]).stdout
    assert "stale     " in shown and "interpolate.h5 has changed since" in shown


def test_what_was_made_from_something_stale_is_stale(folder: Path) -> None:
    """Raw data changed: `interpolate` is stale, and so is all that rests on it."""
    raw = folder / "raw"
    raw.mkdir()
    (raw / "force.csv").write_text("1", encoding="utf-8")
    path, study = artefact_path(folder / "run", "interpolate"), study_of(folder)
    write_record(path, replace(made.interpolated(made.coupled_run()), inputs={"experiment": raw}))
    elastic = replace(made.identified(ALL[0], made.TRUTH), inputs={"interpolate": path})
    made.write_all(study, elastic)
    assert ready(study, "plastic").base["E"] == made.TRUTH["E"]
    (raw / "force.csv").write_text("2", encoding="utf-8")
    with pytest.raises(StudyError, match=r"interpolate\.h5 is stale: experiment '.*raw' has changed since"):
        ready(study, "elastic")
    (reason,) = description_of(open_record(artefact_path(study.run_dir, ALL[0])))["stale"]
    assert "is stale itself" in reason


def test_other_settings_are_said(folder: Path) -> None:
    """A single stage may be asked with other settings; it says which of its inputs were made with others."""
    found = verify.run(study_of(folder, "stages.plastic.tolerance=1.0e-3")).record
    assert any("identify-plastic.h5 was made with other settings: stages.plastic.tolerance" in text for text in found.summary["remarks"])


def test_report_prints_the_mesh_of_the_results(folder: Path) -> None:
    record = report.run(study_of(folder, "mesh=full")).record
    text = (folder / "run" / "report.md").read_text(encoding="utf-8")
    assert "2 x 12 x 1 hex8" in text and "12 x 80 x 4" not in text
    assert record.summary["trustworthy"] is False and "other settings: mesh" in record.summary["verdict"]


def test_a_copied_run_folder_names_its_own_paths(folder: Path, finished: Path) -> None:
    for path in sorted((folder / "run").glob("*.h5")):
        assert str(finished) not in json.dumps(description_of(open_record(path))), path.name
    record = open_record(folder / "run" / "report.h5")
    figures = [Path(text) for text in record.summary["figures"]]
    assert figures and all(figure.is_file() and figure.is_relative_to(folder / "run") for figure in figures)
    assert record.summary["report"] == str(folder / "run" / "report.md") == result_of(record)["report"]
    assert str(folder / "run") in record.summary["verdict"]


def test_a_copied_run_folder_is_fresh_and_not_stale(folder: Path) -> None:
    study = study_of(folder)
    assert verify.run(study).fresh and report.run(study).fresh
    assert description_of(open_record(folder / "run" / "verify.h5"))["stale"] == []


Keys = dict[str, dict[str, Any]]


def keys_of(folder: Path, monkeypatch: pytest.MonkeyPatch, *overrides: str) -> Keys:
    """The configuration by which every stage would be fresh."""
    jobs: dict[str, Job] = {}

    def noted(task: Job, make: Callable[[], Any], *, force: bool = False) -> None:
        jobs[task.stage] = task

    (folder / "raw").mkdir(exist_ok=True)
    study = study_of(folder, *overrides)
    monkeypatch.setattr(interpolate, "produce", noted)
    monkeypatch.setattr(verify, "produce", noted)
    interpolate.run(study)
    verify.run(study)
    found: dict[str, Mapping[str, Any]] = {name: task.config for name, task in jobs.items()}
    found |= {f"identify-{key}": ready(study, key).config for key in ("elastic", "plastic", "thermal")}
    found |= {name: diagnosis_job(study, name)[0].config for name in ("diagnose", "close-loop")}
    return {name: dict(config) for name, config in found.items()}


CHAIN = ("interpolate", *ALL, "verify")


@pytest.mark.parametrize(
    ("change", "again"),
    [
        ("numerics.threads=2", ()),
        ("parameters.kappa={start: 139.65, bounds: [1.0, 900.0]}", ("identify-thermal", "diagnose", "close-loop")),
        ("parameters.kappa={start: 139.65, scale: 10.0}", ("identify-thermal", "diagnose", "close-loop")),
        (f"parameters.M_y0={{start: {1.05 * 129.0!r}, bounds: [1.0, 400.0]}}", ("identify-plastic", "diagnose", "close-loop")),
        ("parameters.E={start: 71400.0, bounds: [1.0e+4, 4.0e+5]}", ("identify-elastic", "diagnose", "close-loop")),
        ("parameters.kappa=150.0", (*ALL, "verify", "diagnose", "close-loop")),
        ("parameters.L=1.6", (*ALL, "verify", "diagnose", "close-loop")),
        ("numerics.newton_tolerance=1.0e-8", (*ALL, "verify", "diagnose", "close-loop")),
        ("numerics.max_time_step=4.0", (*CHAIN, "diagnose", "close-loop")),
        ("diagnosis.max_effects=1", ("close-loop",)),
    ],
)
def test_a_stage_runs_again_for_what_it_reads_only(
    folder: Path, monkeypatch: pytest.MonkeyPatch, change: str, again: tuple[str, ...]
) -> None:
    before, after = keys_of(folder, monkeypatch), keys_of(folder, monkeypatch, change)
    # `verify` remembers that its inputs were made with other settings; here no stage runs again in between.
    for config in (before["verify"], after["verify"]):
        config.pop("made_otherwise", None)
    assert {name for name in before if before[name] != after[name]} == set(again)


def test_threads_make_no_virtual_experiment_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    monkeypatch.setattr(simulate, "produce", lambda task, make, *, force=False: found.append(task.config) or Fake())
    tree = {"name": "v", "parameters": {}, "simulate": {"truth": {"theta_air": 297.0, "theta_clamp": 297.0}}}
    path = tmp_path / "v.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    for threads in (1, 2):
        simulate.run(load_study(path, [f"numerics.threads={threads}", f"run_dir={tmp_path / 'run'}"]))
    assert found[0] == found[1]


class Fake:
    """An outcome that nobody looks into."""

    fresh = False


def test_a_record_holds_bounds_that_its_stage_has_read(folder: Path) -> None:
    """Those of a parameter that is not free are the physical ones: a record stays fresh when the study's change."""
    study = study_of(folder, "parameters.kappa={start: 139.65, bounds: [1.0, 900.0]}")
    base = ready(study, "elastic").base

    class Fit:
        names, at_bound = ("E", "nu"), (False, False)

    class Solved:
        fit, parameters, covariance, budget = Fit(), base, None, None

    results = parameter_results(study, base, Solved())  # type: ignore[arg-type]
    assert (results["kappa"].lower, results["kappa"].upper) == (1e-3, 1e5)
