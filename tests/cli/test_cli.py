"""The command line: help, exit codes, one sentence per error, JSON alone on stdout."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import thermofit
from thermofit.cli.app import app
from thermofit.cli.catalogue import STAGES
from thermofit.core.errors import DataError, NumericsError, StudyError, UntrustworthyError
from thermofit.records.artefact import Dataset, ParameterResult, RecordContent, write_record
from thermofit.records.executor import Executor
from thermofit.records.staging import Outcome, artefact_path
from thermofit.stages import CHAIN
from thermofit.study.study import Study

COMMANDS = ("demo", "new", "run", "inspect", *CHAIN, "show", "diff", "export")
STUDY = """
name: tiny
mesh: coarse
parameters:
  E: {start: 60000, bounds: [30000, 150000]}
  nu: 0.3
  M_y0: 140
  M_yinf: 290
  H_exp: 15
  F: 0.5
  alpha_exp: 23.0e-6
  theta_air: 297.4
  theta_clamp: 296.7
simulate:
  truth: {E: 70000, nu: 0.33, theta_air: 297.4, theta_clamp: 296.7}
"""


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study file of a virtual experiment; runs go below the same folder."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "study.yaml"
    path.write_text(STUDY, encoding="utf-8")
    return path


def call(*arguments: Any) -> Any:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def outcome(path: Path, stage: str, summary: dict[str, Any], fresh: bool = False) -> Outcome:
    """A written record of a stage that identified E."""
    parameters = {
        "E": ParameterResult(69111.3, 403.55, "MPa", True, False, 60000.0, 30000.0, 150000.0),
        "nu": ParameterResult(0.3, None, "1", False, False, 0.3, 0.05, 0.48),
    }
    channels = {"du": {"n": 2856, "rms": 0.00154, "unit": "mm", "chi2_reduced": float("nan"), "floor_rms": 0.00154}}
    made = {
        "verdict": f"{stage} is done",
        "channels": channels,
        "evaluations": {"forward": 8, "failed": 0, "wall_s": 1.5},
        "remarks": ["something [odd] was seen"],
        **summary,
    }
    datasets = {"u/value": Dataset(np.zeros((4, 7, 2)), "mm", ("time", "point", "component"))}
    path.parent.mkdir(parents=True, exist_ok=True)
    return Outcome(write_record(path, RecordContent(stage, {"mesh": "coarse"}, {}, datasets, parameters, made)), fresh)


StageStub = Callable[..., Outcome]


def replace_stages(monkeypatch: pytest.MonkeyPatch, stub: Callable[[str], StageStub]) -> None:
    monkeypatch.setattr(sys.modules["thermofit.cli.app"], "stage_function", stub)


def working(summaries: dict[str, dict[str, Any]] | None = None, calls: list[tuple[str, bool]] | None = None) -> Callable[[str], StageStub]:
    """Stages that write a small record and note that they were called."""

    def function(name: str) -> StageStub:
        def run(study: Study, *, force: bool = False, **_: object) -> Outcome:
            print("a library talks on stdout")
            if calls is not None:
                calls.append((name, force))
            if name == "simulate":
                (study.run_dir / "raw" / "ir").mkdir(parents=True, exist_ok=True)
            return outcome(artefact_path(study.run_dir, name), name, (summaries or {}).get(name, {}))

        return run

    return function


def failing(error: BaseException) -> Callable[[str], StageStub]:
    def run(study: Study, *, force: bool = False, **_: object) -> Outcome:
        raise error

    return lambda name: run


def test_overview_reads_like_a_manual() -> None:
    result = call("--help")
    assert result.exit_code == 0
    text = result.output
    assert all(name in text for name in (*COMMANDS, "data"))
    positions = [text.index(f" {name} ") for name in CHAIN]
    assert positions == sorted(positions), "the chain is listed in its order"
    assert tuple(entry.name for entry in STAGES) == CHAIN
    words = " ".join(text.split())
    assert all(part in words for part in ("An example session", "Where results go", "Exit codes", "not to be trusted"))


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(command: str) -> None:
    result = call(command, "--help")
    assert result.exit_code == 0
    assert "Example" in result.output and f"thermofit {command} " in result.output
    assert "--json" in result.output
    if command not in ("demo", "new", "show", "inspect", "diff", "export"):
        assert all(option in result.output for option in ("--set", "--run-dir", "--force"))


def test_version() -> None:
    assert call("--version").output.strip() == f"thermofit {thermofit.__version__}"


def test_help_show_and_new_do_not_load_numba(tmp_path: Path) -> None:
    """Starting numba costs seconds, and these commands compile nothing."""
    artefact = tmp_path / "verify.h5"
    outcome(artefact, "verify", {})
    code = (
        "import sys\nfrom typer.testing import CliRunner\nfrom thermofit.cli.app import app\n"
        "for arguments in (['--help'], ['run', '--help']):\n"
        "    assert CliRunner().invoke(app, arguments).exit_code == 0\n"
        "assert 'numpy' not in sys.modules\n"
        f"for arguments in (['show', {str(artefact)!r}], ['new', {str(tmp_path / 'n.yaml')!r}]):\n"
        "    assert CliRunner().invoke(app, arguments).exit_code == 0\n"
        "assert not {'numba', 'matplotlib'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_threads_are_set_before_numpy_comes() -> None:
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "OMP_WAIT_POLICY")
    code = f"import sys, os, thermofit.cli; print('numpy' in sys.modules, *(os.environ[name] for name in {names}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=_environment(OMP_NUM_THREADS="3"))
    assert done.stdout.split() == ["False", "1", "3", "PASSIVE"], "a user's own choice stays"


def _environment(**changes: str) -> dict[str, str]:
    import os

    kept = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS") and k != "OMP_WAIT_POLICY"}
    root = str(Path(thermofit.__file__).resolve().parents[1])
    return {**kept, "PYTHONPATH": root, **changes}


def test_module_is_the_command(study: Path) -> None:
    """The real process: one sentence on stderr, no traceback, the exit code."""
    study.write_text(STUDY.replace("mesh: coarse", "mehs: coarse"), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "thermofit.cli", "interpolate", str(study)], capture_output=True, text=True, check=False, env=_environment()
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1 and "mehs" in done.stderr and "did you mean 'mesh'" in done.stderr


def test_usage_errors_end_with_2(study: Path) -> None:
    assert call("interpolat", study).exit_code == 2
    assert call("interpolate", study, "--jsn").exit_code == 2
    assert call("interpolate").exit_code == 2
    assert call().exit_code == 2


def test_misspelt_override_names_the_near_miss(study: Path) -> None:
    result = call("identify-elastic", study, "--set", "stages.elastic.fre=[E]")
    assert result.exit_code == 2
    assert "did you mean 'free'" in result.stderr and result.stderr.startswith("error: ")


def test_missing_artefact_names_the_command_that_makes_it(study: Path) -> None:
    result = call("identify-elastic", study)
    assert result.exit_code == 2
    assert "thermofit interpolate" in result.stderr and result.stderr.count("\n") == 1


def test_missing_raw_folder_is_wrong_data(study: Path) -> None:
    study.write_text(STUDY + "experiment: nowhere\n", encoding="utf-8")
    result = call("interpolate", study)
    assert result.exit_code == 3
    assert "nowhere" in result.stderr


def test_run_dir_is_text_whatever_it_looks_like(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_stages(monkeypatch, working())
    result = call("interpolate", study, "--run-dir", "a: [b, #c", "--json")
    assert result.exit_code == 0, result.stderr
    assert (study.parent / "a: [b, #c" / "interpolate.h5").exists()


@pytest.mark.parametrize(
    ("error", "exit_code", "words"),
    [
        (StudyError("key is\n  wrong"), 2, "key is wrong"),
        (DataError("no time in dic/stage_0003.csv"), 3, "stage_0003"),
        (NumericsError("no convergence at 12.5 s"), 4, "12.5 s"),
        (UntrustworthyError("nothing is identifiable"), 5, "identifiable"),
        (KeyboardInterrupt(), 130, "the same command resumes"),
        (OSError(28, "No space left on device", "/data/x.h5"), 2, "'/data/x.h5' cannot be read or written: No space left on device"),
        (MemoryError(), 4, "memory"),
        (ZeroDivisionError("division by zero"), 1, "unexpected ZeroDivisionError: division by zero"),
    ],
)
def test_every_failure_is_one_sentence(
    study: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, exit_code: int, words: str
) -> None:
    replace_stages(monkeypatch, failing(error))
    result = call("verify", study)
    assert result.exit_code == exit_code and result.stdout.startswith("verify  study ") and result.stdout.count("\n") == 1
    assert words in result.stderr and result.stderr.startswith("error: ") and result.stderr.count("\n") == 1
    with_json = call("verify", study, "--json")
    answer = json.loads(with_json.stdout)
    assert with_json.exit_code == answer["exit_code"] == exit_code
    assert words in answer["error"]
    assert call("run", study).exit_code == exit_code


def test_traceback_only_on_request(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_stages(monkeypatch, failing(ZeroDivisionError("x")))
    assert "Traceback" not in call("verify", study).stderr
    monkeypatch.setenv("THERMOFIT_TRACEBACK", "1")
    result = call("verify", study)
    assert "Traceback" in result.stderr and result.exit_code == 1


def test_json_is_alone_on_stdout_and_keeps_the_contract(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_stages(monkeypatch, working())
    result = call("identify-elastic", study, "--json", "--force")
    assert result.exit_code == 0, result.stderr
    answer = json.loads(result.stdout)
    assert answer["stage"] == "identify-elastic" and answer["verdict"] == "identify-elastic is done"
    assert answer["fresh"] is False and answer["trustworthy"] is True
    assert {"value", "sigma", "unit", "free", "at_bound"} <= set(answer["parameters"]["E"])
    assert answer["parameters"]["nu"]["sigma"] is None
    assert set(answer["channels"]["du"]) == {"n", "rms", "unit", "chi2_reduced", "floor_rms"}
    assert answer["channels"]["du"]["chi2_reduced"] is None, "nan is null"
    assert answer["evaluations"] == {"forward": 8, "failed": 0, "wall_s": 1.5}
    assert "talks" in result.stderr


def test_human_output_says_the_same(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_stages(monkeypatch, working())
    result = call("identify-elastic", study)
    lines = result.stdout.splitlines()
    assert lines[-1] == "verdict   identify-elastic is done"
    for part in ("69111", "404", "30000 .. 150000", "2856", "! something [odd] was seen", "identify-elastic.h5", "8 forward"):
        assert part in result.stdout
    assert "nu" not in [line.split()[0] for line in lines if line.split()], "fixed parameters are no result"


def test_notes_are_printed_with_verbose_alone(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What asks for nothing stays in the record, the report and the JSON, of one stage and of the chain."""
    note = {"notes": ["c_p [=] c0 + more"]}
    replace_stages(monkeypatch, lambda name: lambda study, *, force=False: outcome(study.run_dir / f"{name}.h5", name, note))
    for command in ("identify-elastic", "run"):
        assert "c_p [=]" not in (plain := call(command, study).stdout) and "something [odd]" in plain
        assert "- c_p [=] c0 + more" in call(command, study, "--verbose", "--force").stdout
    assert json.loads(call("identify-elastic", study, "--json").stdout)["notes"] == note["notes"]


def test_the_command_that_comes_next_is_named(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a fit the loop; after the loop, where it added something, the study that holds it. Not beside --quiet or --json."""
    added = {"added": ["lamp"]}
    replace_stages(monkeypatch, lambda name: lambda study, *, force=False: outcome(study.run_dir / f"{name}.h5", name, added))
    loop = f"next      thermofit close-loop {study}"
    for arguments in (("run", study), ("verify", study), ("diagnose", study)):
        assert [line for line in call(*arguments).stdout.splitlines()[-3:] if line.startswith(loop)], arguments
    assert "with-effects.yaml --until verify" in "".join(call("close-loop", study).stdout.splitlines()[-3:])
    assert "next " not in call("run", study, "--until", "identify-plastic").stdout
    assert "next " not in call("run", study, "--quiet").stdout and "next " not in call("verify", study, "--json").stdout
    added.clear()
    assert "next " not in call("close-loop", study, "--force").stdout


def test_fresh_is_said(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = outcome(study.parent / "verify.h5", "verify", {}, fresh=True)
    replace_stages(monkeypatch, lambda name: lambda study, *, force=False: made)
    assert "fresh" in call("verify", study).stdout.splitlines()[1]
    assert json.loads(call("verify", study, "--json").stdout)["fresh"] is True


def test_doubtful_answer_is_printed_and_ends_with_5(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_stages(monkeypatch, working({"identify-elastic": {"trustworthy": False, "verdict": "E is at its bound"}}))
    result = call("identify-elastic", study)
    assert result.exit_code == 5
    assert "E is at its bound" in result.stdout.splitlines()[-1]
    with_json = call("identify-elastic", study, "--json")
    assert (with_json.exit_code, json.loads(with_json.stdout)["trustworthy"]) == (5, False)


def test_run_goes_through_the_chain_and_ends_with_the_table(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[str, bool]] = []
    replace_stages(monkeypatch, working({"report": {"figures": ["figures/one.png"]}}, calls))
    result = call("run", study)
    assert result.exit_code == 0, result.stderr
    assert [name for name, _ in calls] == [name for name in CHAIN if name not in ("gridsearch", "sensitivity")]
    assert not any(force for _, force in calls)
    row = next(line for line in result.stdout.splitlines() if line.split()[:1] == ["E"])
    assert row.split() == ["E", "MPa", "70000", "60000", "69111", "404", "-1.27", "%"]
    assert "figure    figures/one.png" in result.stdout
    assert result.stdout.splitlines()[-1].startswith("verdict   9 stages done")


def test_run_as_json(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    doubt = {"trustworthy": False, "verdict": "not verified"}
    calls: list[tuple[str, bool]] = []
    replace_stages(monkeypatch, working({"verify": doubt}, calls))
    result = call("run", study, "--json", "--force", "--all", "--from", "identify-elastic")
    answer = json.loads(result.stdout)
    assert result.exit_code == 5 and answer["trustworthy"] is False and "not verified" in answer["verdict"]
    assert calls[-1] == ("report", True), "the chain goes on after a doubtful stage"
    skipped = [step["stage"] for step in answer["steps"] if "skipped" in step]
    assert skipped == ["gridsearch", "sensitivity"], "the study lists none"
    assert answer["table"][0]["true"] == 70000.0
    assert answer["parameters"]["E"]["value"] == pytest.approx(69111.3)


@pytest.mark.parametrize("command", ["gridsearch", "sensitivity"])
def test_independent_problems_go_where_the_options_say(study: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    seen: list[Executor] = []

    def function(name: str) -> StageStub:
        def run(study: Study, *, force: bool = False, where: Executor) -> Outcome:
            seen.append(where)
            return outcome(artefact_path(study.run_dir, name), name, {})

        return run

    replace_stages(monkeypatch, function)
    assert call(command, study, "--jobs", "2", "--set", "numerics.threads=4").exit_code == 0
    assert call(command, study, "--scheduler", "tcp://a:8786", "--set", "numerics.threads=4").exit_code == 0
    assert call(command, study).exit_code == 0
    assert seen == [Executor(2, None, 2), Executor(1, "tcp://a:8786", 1), Executor(1, None, 2)]
    for wrong in (("--jobs", "0"), ("--jobs", "2", "--scheduler", "tcp://a:8786")):
        result = call(command, study, *wrong)
        assert result.exit_code == 2 and "expected" in result.stderr and len(result.stderr.splitlines()) == 1
    assert call("verify", study, "--jobs", "2").exit_code == 2, "one run has nothing to share out"


def test_close_loop_adds_as_many_effects_as_the_option_says(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []

    def function(name: str) -> StageStub:
        def run(study: Study, *, force: bool = False) -> Outcome:
            if name == "close-loop":
                seen.append(study.diagnosis.max_effects)
            (study.run_dir / "raw" / "ir").mkdir(parents=True, exist_ok=True)
            return outcome(artefact_path(study.run_dir, name), name, {})

        return run

    replace_stages(monkeypatch, function)
    for options in ((), ("--max-effects", "1"), ("--max-effects", "0", "--set", "diagnosis.max_effects=2")):
        assert call("close-loop", study, *options).exit_code == 0
    assert seen == [3, 1, 0], "the study's, the option's, and the option's before that of --set"
    result = call("close-loop", study, "--max-effects", "-1")
    assert result.exit_code == 2 and len(result.stderr.splitlines()) == 1
    assert "diagnosis.max_effects" in result.stderr and "is -1; expected at least 0" in result.stderr
    assert call("diagnose", study, "--max-effects", "1").exit_code == 2, "nothing is added there"


def test_run_refuses_an_unknown_stage(study: Path) -> None:
    result = call("run", study, "--from", "identify-plastik")
    assert result.exit_code == 2 and "did you mean 'identify-plastic'" in result.stderr


def test_show_describes_an_artefact(tmp_path: Path) -> None:
    path = tmp_path / "verify.h5"
    phases = [{"label": "rest", "t0": 0.0, "t1": 3.0}, {"label": "elastic", "t0": 3.0, "t1": 8.0}]
    outcome(path, "verify", {"phases": phases, "energy": {"work": 12.5}})
    human = call("show", path).stdout
    for part in (
        "u/",
        "mm",
        "value  [mm]  time 4 x point 7 x component 2  float64",
        "energy.work",
        "12.5",
        "elastic",
        "fixed",
        "numpy",
        "mesh",
        "coarse",
    ):
        assert part in human, part
    answer = json.loads(call("show", path, "--json").stdout)
    assert answer["datasets"]["u/value"] == {"unit": "mm", "dims": ["time", "point", "component"], "shape": [4, 7, 2], "dtype": "float64"}
    assert answer["config"] == {"mesh": "coarse"} and answer["inputs"] == {} and answer["phases"] == phases
    assert answer["attributes"]["thermofit_version"] == thermofit.__version__


def test_show_of_doubtful_result_is_no_failure(tmp_path: Path) -> None:
    path = tmp_path / "verify.h5"
    outcome(path, "verify", {"trustworthy": False})
    assert call("show", path).exit_code == 0


def test_show_of_a_folder_lists_its_artefacts(tmp_path: Path) -> None:
    for stage in ("identify-elastic", "verify"):
        outcome(tmp_path / f"{stage}.h5", stage, {})
    listed = json.loads(call("show", tmp_path, "--json").stdout)
    assert [row["verdict"] for row in listed["artefacts"]] == ["identify-elastic is done", "verify is done"]
    assert "verify is done" in call("show", tmp_path).stdout
    assert call("show", tmp_path, "--plot").exit_code == 2


def test_show_of_a_dataset_gives_its_values(tmp_path: Path) -> None:
    path = tmp_path / "verify.h5"
    outcome(path, "verify", {})
    told = json.loads(call("show", path, "--dataset", "u/value", "--json").stdout)
    assert np.array(told["values"]).shape == (4, 7, 2) and told["unit"] == "mm"
    assert "0 to 0, mean 0" in call("show", path, "--dataset", "u/value").stdout
    wrong = call("show", path, "--dataset", "v/value")
    assert wrong.exit_code == 3 and "it holds u/value" in wrong.stderr


@pytest.mark.parametrize("name", ["u/value", None])
def test_show_draws(tmp_path: Path, name: str | None) -> None:
    path = tmp_path / "verify.h5"
    over_time = {
        "u/value": Dataset(np.random.default_rng(0).normal(size=(4, 7, 2)), "mm", ("time", "point", "component")),
        "over_time/du": Dataset(np.arange(4.0), "1", ("time",)),
        "over_time/time": Dataset(np.arange(4.0), "s", ("time",)),
    }
    write_record(path, RecordContent("verify", {}, {}, over_time, {}, {"verdict": "done"}))
    done = call("show", path, "--plot", *(("--dataset", name) if name else ()))
    assert done.exit_code == 0, done.output
    pictures = list((tmp_path / "figures").glob("*.png"))
    assert len(pictures) == 1 and pictures[0].name in done.stdout.replace("\n", "") and pictures[0].stat().st_size > 5000


def test_show_refuses_what_is_no_artefact(tmp_path: Path) -> None:
    path = tmp_path / "verify.h5"
    outcome(path, "verify", {})
    path.write_bytes(path.read_bytes()[:900])
    result = call("show", path)
    assert result.exit_code == 3 and "verify.h5" in result.stderr and result.stderr.count("\n") == 1
    assert call("show", tmp_path / "missing.h5").exit_code == 2
    (tmp_path / "empty").mkdir()
    folder = call("show", tmp_path / "empty")
    assert folder.exit_code == 2 and "is a folder" in folder.stderr


@pytest.mark.parametrize(("name", "words"), [("study.yaml", "`thermofit run"), ("force.csv", "`thermofit inspect")])
def test_show_of_another_file_does_not_advise_to_remove_it(study: Path, name: str, words: str) -> None:
    path = study.parent / name
    path.touch()
    result = call("show", path)
    assert result.exit_code == 2 and "is no artefact" in result.stderr and words in result.stderr
    assert "remove" not in result.stderr


def test_new_writes_a_study_that_loads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from thermofit.study.study import load_study

    monkeypatch.chdir(tmp_path)
    raw = tmp_path / "lab" / "test #7"
    raw.mkdir(parents=True)
    (raw / "experiment.yaml").write_text("", encoding="utf-8")
    (tmp_path / "studies").mkdir()
    result = call("new", "studies/07.yaml", "--experiment", "lab/test #7")
    assert result.exit_code == 0, result.stderr
    study = load_study("studies/07.yaml")
    assert (study.name, study.experiment.resolve()) == ("07", raw)
    again = call("new", "studies/07.yaml")
    assert again.exit_code == 2 and "--force" in again.stderr
    assert load_study("studies/07.yaml").experiment.resolve() == raw, "nothing was overwritten"
    answer = json.loads(call("new", "studies/07.yaml", "--force", "--json").stdout)
    assert answer["stage"] == "new" and load_study("studies/07.yaml").experiment.name == "my-experiment"


def test_new_with_a_hardening_law(tmp_path: Path) -> None:
    from thermofit.study.study import load_study

    path = tmp_path / "study.yaml"
    unknown = call("new", path, "--hardening", "swfit")
    assert unknown.exit_code == 2 and "'swfit' is not known; known are voce, model2" in unknown.stderr and not path.exists()
    assert call("new", path, "--hardening", "swift").exit_code == 0
    assert load_study(path).stage("plastic").free == ("M_y0", "swift.e0", "swift.n", "F")


def test_new_refuses_a_folder_without_experiment(tmp_path: Path) -> None:
    result = call("new", tmp_path / "study.yaml", "--experiment", tmp_path)
    assert result.exit_code == 2 and "experiment.yaml" in result.stderr
    assert not (tmp_path / "study.yaml").exists()
    assert call("new", tmp_path / "missing" / "study.yaml").exit_code == 2


@pytest.mark.parametrize("command", ["diagnose", "close-loop"])
def test_a_joint_fit_that_is_there_is_made_anew_with_what_it_rests_on(study: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    """Else it would be refused as stale as soon as a stage before it was made anew, by a later version for example."""

    def chain(study: Study, links: Any, selection: Any, report: Any = None) -> None:
        raise StudyError(f"until {selection.last}")

    monkeypatch.setattr("thermofit.stages.run.chain", chain)
    run_dir = study.parent / "runs" / "tiny"
    assert "until identify-thermal" in call(command, study, "--run-dir", run_dir).output
    run_dir.mkdir(parents=True, exist_ok=True)
    (run_dir / "refine.h5").write_bytes(b"")
    assert "until refine" in call(command, study, "--run-dir", run_dir).output
