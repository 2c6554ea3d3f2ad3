"""`identifiability` on a tiny virtual experiment: the plan predicts what the fit finds; valleys are named; killed work resumes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tiny
from typer.testing import CliRunner

from thermofit.cli import app
from thermofit.core.artefact import open_record
from thermofit.core.errors import StudyError
from thermofit.core.study import Study
from thermofit.stages import identifiability
from thermofit.stages.identifiability import Options

StudyOf = Callable[..., Study]
HERE = Path(__file__).parent
ISOTHERMAL = (
    "stages.thermal.free=[alpha_exp, kappa, c0, beta]",
    *("parameters.alpha_air=0.0", "parameters.alpha_clamp=1.0e8", "simulate.truth.alpha_air=0.0", "simulate.truth.alpha_clamp=1.0e8"),
)
"""Jaws as in the thesis, without exchange with the air."""


def test_at_the_optimum(study_of: StudyOf) -> None:
    """Standard errors are those of the stage; bootstrap and profile agree with them on data whose model is right."""
    study = study_of()
    record = identifiability.run(study, Options(repeats=400, profile=True)).record
    identified = open_record(study.run_dir / "identify-thermal.h5")
    assert record.summary["kind"] == "unique" and record.summary["trustworthy"] and record.summary["verdict"].startswith("unique: ")
    for name in ("alpha_exp", "c0", "beta"):
        p, q = identified.parameters[name], record.parameters[name]
        assert q.value == p.value and q.sigma == pytest.approx(p.sigma, rel=1e-2)
        ways = record.summary["intervals"][name]
        laplace = ways["laplace"]["high"] - ways["laplace"]["low"]
        assert laplace == pytest.approx(2.0 * 1.96 * q.sigma, rel=0.01)
        assert ways["profile"]["high"] - ways["profile"]["low"] == pytest.approx(laplace, rel=0.1)
        assert 0.5 < (ways["bootstrap"]["high"] - ways["bootstrap"]["low"]) / laplace < 2.0
    assert not list(study.run_dir.glob(".identifiability*"))
    assert all(Path(path).exists() for path in record.summary["figures"])
    assert identifiability.run(study, Options(repeats=400, profile=True)).fresh
    assert not identifiability.run(study, Options(repeats=100)).fresh


@pytest.mark.parametrize("stage", ["plastic", "thermal"])
def test_plan_predicts_the_standard_errors(study_of: StudyOf, stage: str) -> None:
    """Before the test, from programme, declared noise and assumed material alone: what the identification then reports."""
    study = study_of()
    planned = identifiability.run(study, Options(stage, before=True)).record
    found = open_record(study.run_dir / f"identify-{stage}.h5")
    assert planned.summary["kind"] == "unique"
    for name, parameter in planned.parameters.items():
        assert parameter.value == tiny.TRUTH[name]
        assert found.parameters[name].sigma == pytest.approx(parameter.sigma, rel=0.35), name


def test_model_1_between_isothermal_jaws_is_a_valley(study_of: StudyOf) -> None:
    """Every term of the heat balance carries one thermal parameter as a factor: only their ratios are in the temperatures."""
    summary = identifiability.run(study_of("model=1", *ISOTHERMAL), Options(before=True, programme="monotonic")).record.summary
    assert summary["kind"] == "valley" and not summary["trustworthy"]
    (flat,) = summary["flat_directions"]
    assert set(flat["members"]) == {"alpha_exp", "kappa", "c0", "beta"}
    assert {c["combination"] for c in flat["constant"]} == {"alpha_exp/beta", "kappa/beta", "c0/beta"}
    assert all(c["drift"] < 0.01 for c in flat["constant"])
    assert {tuple(names) for names in summary["to_fix"]} == {("alpha_exp",), ("kappa",), ("c0",), ("beta",)}
    assert "constant along it: " in summary["verdict"] and "fix one of" in summary["verdict"]


@pytest.mark.parametrize("changes", [("model=2", *ISOTHERMAL), ("model=1", ISOTHERMAL[0])], ids=["model 2", "contact prescribed"])
def test_unique_where_one_term_has_no_factor(study_of: StudyOf, changes: tuple[str, ...]) -> None:
    """The dissipation of model 2 is not a multiple of beta; a film coefficient that is given sets the scale of all others."""
    summary = identifiability.run(study_of(*changes), Options(before=True)).record.summary
    assert summary["kind"] == "unique", summary["verdict"]
    assert summary["to_fix"] == [[]]


def test_plain_displacements_are_moved_by_the_machine(study_of: StudyOf) -> None:
    """The plan says before the test that u softens E and du does not (thesis Table 5.2)."""
    moved = {}
    for channel in ("u", "du"):
        study = study_of("stages.elastic.window=[0, 6]", f"stages.elastic.channels={{{channel}: {{}}}}")
        (row,) = identifiability.run(study, Options("elastic", before=True)).record.summary["moved_by"]
        moved[channel] = row["E"]
    assert moved["u"] < -0.1 and abs(moved["du"]) < 0.01


def test_programmes_are_ranked(study_of: StudyOf) -> None:
    study = study_of("model=1", "numerics.max_time_step=20.0")
    record = identifiability.run(study, Options(compare=("monotonic", "load-unload-cool"))).record
    rows = record.summary["programmes"]
    assert [row["rank"] for row in rows] == [1, 2] and {row["programme"] for row in rows} == {"monotonic", "load-unload-cool"}
    assert rows[0]["D"] < rows[1]["D"] and rows[0]["programme"] in record.summary["verdict"]
    assert all(np.isfinite(row["beta"]) for row in rows)
    with pytest.raises(StudyError, match="test programme 'twist' is not known; expected some of own, monotonic"):
        identifiability.run(study, Options(compare=("twist",)))


def test_command_line(study_of: StudyOf) -> None:
    """--json alone on stdout, exit 5 where the parameters are not determined, one sentence for options that do not fit."""
    source = str(study_of().source)
    sets = [part for change in ("model=1", *ISOTHERMAL) for part in ("--set", change)]
    result = CliRunner().invoke(app, ["identifiability", source, "--a-priori", "--json", *sets])
    assert result.exit_code == 5, result.output
    answer = json.loads(result.stdout)
    assert (
        answer["kind"] == "valley" and answer["stage"] == "identifiability-a-priori" and answer["intervals"]["beta"]["laplace"]["open_high"]
    )
    for arguments, text in (
        (["--a-priori", "--bootstrap", "10"], "--a-priori has none"),
        (["--refit"], "give --bootstrap N too"),
        (["monotonic"], "given without --compare"),
        (["--programme", "cycles"], "give --a-priori too"),
        (["--stage", "therml"], "stage 'therml' is not known"),
    ):
        wrong = CliRunner().invoke(app, ["identifiability", source, *arguments])
        assert wrong.exit_code == 2 and text in wrong.stderr, wrong.output


def test_missing_optimum_names_the_command(study_of: StudyOf) -> None:
    study = study_of()
    (study.run_dir / "identify-thermal.h5").unlink()
    with pytest.raises(StudyError, match=r"run `thermofit identify-thermal tiny\.yaml` first"):
        identifiability.run(study)


@pytest.mark.parametrize("options", ["profile=True", "repeats=12, refit=True"])
def test_killed_analysis_resumes(study_of: StudyOf, options: str) -> None:
    """Killed with parts of the work on disk, the same command finishes with the same answer and computes none of these again."""
    study = study_of("stages.thermal.free=[c0, beta]")
    from thermofit.stages import identify_thermal

    identify_thermal.run(study)
    whole = identifiability.run(study, eval(f"Options({options})")).record.summary["intervals"]
    folder = study.run_dir / ".identifiability.parts.evaluations"
    code = (
        f"import tiny; from thermofit.stages.identifiability import Options, run; "
        f"run(tiny.load_study({str(study.source)!r}, ['stages.thermal.free=[c0, beta]']), Options({options}), force=True)"
    )
    root = str(HERE.parents[1])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([root, str(HERE)]), "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen([sys.executable, "-c", code], env=environment) as process:
        deadline = time.monotonic() + 300.0
        while len(list((folder / "done").glob("*.npz"))) < 2:
            assert process.poll() is None and time.monotonic() < deadline, "ended before two parts were on disk"
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
    kept = {path: path.stat().st_mtime_ns for path in (folder / "done").glob("*.npz")}
    computed: list[Path] = []
    original = identifiability.discard_checkpoints

    def seen(task: object) -> None:
        computed.extend(path for path in (folder / "done").glob("*.npz") if kept.get(path) != path.stat().st_mtime_ns)
        assert all(path.exists() and path.stat().st_mtime_ns == at for path, at in kept.items()), "a finished part was computed again"
        original(task)  # type: ignore[arg-type]

    identifiability.discard_checkpoints = seen  # type: ignore[assignment]
    try:
        again = identifiability.run(study, eval(f"Options({options})"), force=True).record.summary["intervals"]
    finally:
        identifiability.discard_checkpoints = original
    assert computed and again == whole
