"""`gridsearch` on a tiny virtual experiment: one optimum from all starts, failures counted, finished starts not repeated."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from thermofit.core.errors import NumericsError, StudyError
from thermofit.identify import trials
from thermofit.identify.stage import ready
from thermofit.records.artefact import open_record
from thermofit.records.staging import job
from thermofit.stages import gridsearch
from thermofit.study.study import Study

StudyOf = Callable[..., Study]
FIRST, SECOND = {"alpha_exp": 23.0e-6, "c0": 2.43, "beta": 1.0}, {"alpha_exp": 12.0e-6, "c0": 4.0, "beta": 0.5}


def test_all_starts_reach_the_optimum_of_the_stage(study_of: StudyOf) -> None:
    study = study_of()
    outcome = gridsearch.run(study)
    assert outcome.fresh and outcome.record.summary["uniqueness"] == "unique" and outcome.record.summary["trustworthy"]
    summary, stage = outcome.record.summary, open_record(study.run_dir / "identify-thermal.h5")
    assert len(summary["starts"]) == 2 and summary["starts"][1]["given"] == SECOND
    for name in ("alpha_exp", "c0", "beta"):
        # Same model, same start values of the mechanics: the same optimum up to the tolerance of the search.
        assert outcome.record.parameters[name].value == pytest.approx(stage.parameters[name].value, rel=1e-3)
        assert summary["spread"][name] < 1e-3
    assert outcome.record["starts/optimum"].value.shape == (2, 3)
    assert summary["evaluations"]["forward"] == sum(s["evaluations"]["forward"] for s in summary["starts"])


def test_mechanics_is_solved_once_for_all_starts(study_of: StudyOf, monkeypatch: pytest.MonkeyPatch) -> None:
    study, made = study_of(), []
    original = trials.model_on

    def counted(*args: object) -> object:
        inner = original(*args)  # type: ignore[arg-type]
        return lambda size, base: made.append(size) or inner(size, base)

    monkeypatch.setattr(trials, "model_on", counted)
    gridsearch.run(study, force=True)
    assert len(made) == 1


def test_a_start_that_fails_is_counted_and_named(study_of: StudyOf, monkeypatch: pytest.MonkeyPatch) -> None:
    solve = trials.solve

    def failing(*args: object, **how: object) -> object:
        if args[2]["c0"] == 4.0:  # type: ignore[index]
            raise NumericsError("step 3 does not converge")
        return solve(*args, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(trials, "solve", failing)
    study = study_of(gridsearch={"stage": "thermal", "starts": [FIRST, SECOND, {"beta": 0.5}]})
    summary = gridsearch.run(study).record.summary
    assert summary["verdict"].endswith("; 1 failed") and summary["uniqueness"] == "unique"
    assert summary["starts"][1] == {"given": SECOND, "failed": True, "converged": False, "message": "step 3 does not converge"}
    assert "start 2 failed: step 3 does not converge" in summary["remarks"]


def test_all_starts_failing_is_an_error_and_keeps_the_artefact(study_of: StudyOf, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: object, **__: object) -> object:
        raise NumericsError("no equilibrium")

    study = study_of()
    before = (study.run_dir / "gridsearch.h5").read_bytes()
    monkeypatch.setattr(trials, "solve", failing)
    with pytest.raises(NumericsError, match="all 2 starts failed, the first with: no equilibrium"):
        gridsearch.run(study, force=True)
    assert (study.run_dir / "gridsearch.h5").read_bytes() == before


def test_starts_cut_short_are_not_compared(study_of: StudyOf) -> None:
    summary = gridsearch.run(study_of("stages.thermal.max_evaluations=3")).record.summary
    assert summary["uniqueness"] == "nothing to compare" and not summary["trustworthy"]
    assert summary["verdict"].endswith("2 did not converge")


def interrupted(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    """A grid search that is ended at its second start."""
    solve, calls = trials.solve, []

    def at_second(*args: object, **how: object) -> object:
        calls.append(args)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return solve(*args, **how)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(trials, "solve", at_second)
        with pytest.raises(KeyboardInterrupt):
            gridsearch.run(study, force=True)


def test_finished_starts_are_not_repeated(study_of: StudyOf, monkeypatch: pytest.MonkeyPatch) -> None:
    study = study_of()
    interrupted(study, monkeypatch)
    assert list(study.run_dir.glob(".gridsearch.1.*"))
    summary = gridsearch.run(study, force=True).record.summary
    first, second = (s["evaluations"] for s in summary["starts"])
    assert first["forward"] == 0 and first["replayed"] > 3 and second["replayed"] == 0 and second["forward"] > 3
    assert not list(study.run_dir.glob(".gridsearch.*"))


def test_evaluations_of_other_data_are_not_taken_over(study_of: StudyOf, monkeypatch: pytest.MonkeyPatch) -> None:
    """The key of the evaluations holds the content of the inputs, not their paths."""
    from thermofit.stages import identify_elastic, identify_plastic, identify_thermal, interpolate

    study = study_of()
    interrupted(study, monkeypatch)
    changed = study_of("noise.temperature=0.1")
    interpolate.run(changed)
    for stage in (identify_elastic, identify_plastic, identify_thermal):
        stage.run(changed)
    summary = gridsearch.run(changed).record.summary
    assert summary["evaluations"]["replayed"] == 0
    assert summary["channels"]["dtheta"]["chi2_reduced"] < 0.2


def test_study_without_grid_or_with_a_fixed_parameter_is_refused(study_of: StudyOf) -> None:
    with pytest.raises(StudyError, match=r"tiny\.yaml: key 'gridsearch' is missing"):
        gridsearch.run(study_of(gridsearch=None))
    with pytest.raises(StudyError, match=r"gridsearch\.starts\.0' gives kappa, which stages\.thermal\.free does not identify"):
        gridsearch.run(study_of(gridsearch={"stage": "thermal", "starts": [{"kappa": 150.0}]}))


def test_missing_artefact_names_the_command(study_of: StudyOf) -> None:
    study = study_of()
    (study.run_dir / "identify-plastic.h5").unlink()
    with pytest.raises(StudyError, match=r"run `thermofit identify-plastic tiny\.yaml` first"):
        gridsearch.run(study)


def test_elastic_stage_can_be_searched_too(study_of: StudyOf) -> None:
    study = study_of(gridsearch={"stage": "elastic", "starts": [{"E": 40000.0, "nu": 0.2}, {"E": 90000.0, "nu": 0.4}]})
    record = gridsearch.run(study).record
    assert record.summary["uniqueness"] == "unique"
    assert record.parameters["E"].value == pytest.approx(open_record(study.run_dir / "identify-elastic.h5").parameters["E"].value, rel=1e-3)
    assert np.all(record["starts/converged"].value)


def test_drawn_starts_follow_the_listed_ones(study_of: StudyOf) -> None:
    study = study_of(gridsearch={"stage": "thermal", "starts": [FIRST], "draw": {"method": "sobol", "number": 2, "seed": 9}})
    record = gridsearch.run(study).record
    assert record.summary["uniqueness"] == "unique" and record.attributes["seed"] == 9
    begun = record["starts/start"].value
    assert begun.shape == (3, 3) and begun[0].tolist() == list(FIRST.values()) and len(np.unique(begun[:, 0])) == 3
    assert [row["ends in"] for row in record.summary["optima"]] == ["optimum 1"] * 3
    picture = study.run_dir / "figures" / "gridsearch-basins.png"
    assert picture.stat().st_size > 5000 and str(picture) in record.summary["figures"].values()
    picture.unlink()
    assert gridsearch.run(study).fresh and picture.exists(), "a picture that is gone is drawn again"


def test_a_worker_that_does_not_see_the_run_folder_answers_the_same(study_of: StudyOf, tmp_path: Path) -> None:
    """Another machine: nothing is written where the run folder would be, the answer comes back by value."""
    study = study_of()
    whole = open_record(study.run_dir / "gridsearch.h5")
    stage = ready(study, "thermal")
    stage, optimum = gridsearch.with_optimum(study, gridsearch.settings_of(study), stage)
    common = trials.setup(study, stage, job(study.run_dir, "gridsearch", stage.config, stage.inputs), optimum)
    away = replace(common, keep=replace(common.keep, path=tmp_path / "elsewhere" / "gridsearch.h5"), mark="x")
    answer = pickle.loads(pickle.dumps(trials.trial_answer(*pickle.loads(pickle.dumps((away, "gridsearch.2", SECOND, False))))))
    assert not (tmp_path / "elsewhere").exists()
    assert list(answer.summary["trial"]["optimum"].values()) == pytest.approx(whole["starts/optimum"].value[1].tolist(), rel=1e-9)
