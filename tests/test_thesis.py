"""The studies of the thesis's experiments, what the thesis printed about them, and how their runs build on one another."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import yaml

from thermofit.core.errors import StudyError
from thermofit.core.parameters import param
from thermofit.records.artefact import ParameterResult, Record, RecordContent, write_record
from thermofit.study.study import Study, load_study

ROOT = Path(__file__).parents[1]
SIX = ("alpha_exp", "kappa", "c0", "beta", "alpha_air", "alpha_clamp", "f")


def study(name: str) -> Study:
    return load_study(ROOT / "configs" / f"{name}.yaml")


def truth(name: str) -> dict[str, float]:
    settings = study(name).simulate
    assert settings is not None
    return dict(settings.truth)


def test_truth_of_the_studies_is_what_the_thesis_identified(scripts: Any) -> None:
    printed = scripts("thesis_printed")
    expected = {
        "exp1": {**printed.TABLE_5_2["relative displacements"], **printed.TABLE_5_3, **printed.TABLE_5_6, "beta": 1.0},
        "exp1-models": {**printed.TABLE_5_2["relative displacements"], **printed.TABLE_5_8[1], **printed.TABLE_5_15},
        "exp2": {**printed.TABLE_5_12, **printed.TABLE_5_13[2], **printed.TABLE_5_15},
        "exp3": {**printed.TABLE_5_16, **printed.TABLE_5_19},
    }
    for name, values in expected.items():
        found = truth(name)
        for parameter, value in values.items():
            assert parameter == "f" or found[parameter] == pytest.approx(value, rel=1e-12), f"{name}: {parameter}"


def test_material_of_the_model_dependency_is_neither_model() -> None:
    for name in ("exp1-models", "exp2"):
        settings = study(name).simulate
        assert settings is not None and settings.model == 1 and settings.truth["stored_energy.slope"] == 8.0
        assert "stored_energy.slope" not in study(name).parameters


def test_slope_of_the_virtual_material_gives_the_heat_of_table_5_15(scripts: Any) -> None:
    """The two numbers of the dissipation follow from Table 5.15: its onset, and its sum to a plastic strain of 0.15."""
    import numpy as np

    values = {**scripts("thesis_printed").TABLE_5_13[2], **scripts("thesis_printed").TABLE_5_15}
    strain = np.linspace(0.0, 0.15, 1501)
    share = 1.0 - np.exp(-values["H_exp"] * strain)
    first, last, beta = values["M_y0"], values["M_yinf"], values["beta"]
    heat = np.trapezoid((last - first) * share**2 + (1.0 - beta) * first * share + beta * first, strain)
    found = truth("exp2")
    assert np.trapezoid(found["beta"] * first * (1.0 + found["stored_energy.slope"] * strain), strain) == pytest.approx(heat, rel=0.01)


def test_starts_and_prescribed_values_are_those_of_the_tables(scripts: Any) -> None:
    printed, runs = scripts("thesis_printed"), scripts("thesis_runs")
    counts = {"exp1": 7, "exp1-models": 4, "exp2": 4, "exp3": 10}
    for name, count in counts.items():
        settings = study(name).gridsearch
        assert settings is not None and settings.stage == "thermal" and len(settings.starts) == count
        assert all(set(start) == set(study(name).stages.thermal.free) for start in settings.starts)
    jaws = study("exp3").sensitivity
    assert jaws is not None and set(jaws.values) == set(printed.TABLE_5_21)
    assert set(runs.AIR) == set(printed.TABLE_5_20)


def test_printed_tables_agree_with_the_collected_ones(scripts: Any) -> None:
    """Against the collected figures of the thesis, where the data folder with its neighbour `reference` is there."""
    data = os.environ.get("THERMOFIT_DATA")
    path = Path(data).parent / "reference" / "thesis_tables.yaml" if data else None
    if path is None or not path.exists():
        pytest.skip("no thesis_tables.yaml beside the folder THERMOFIT_DATA")
    tables, printed = yaml.safe_load(path.read_text(encoding="utf-8")), scripts("thesis_printed")

    def same(ours: dict[str, float], theirs: dict[str, Any]) -> None:
        known = {name: theirs[{"f": "f_theta", "alpha_clamp": "alpha_cl"}.get(name, name)] for name in ours}
        assert {**ours, **({"alpha_exp": 1e6 * ours["alpha_exp"]} if "alpha_exp" in ours else {})} == pytest.approx(known)

    same(printed.TABLE_5_3, tables["table_5_3_plastic_exp1_model1"]["optimal"])
    same(printed.TABLE_5_6, tables["table_5_6_optimal_thermal_exp1_model1"])
    for model in (1, 2):
        same(printed.TABLE_5_8[model], tables["table_5_8_plastic_exp1"][f"model{model}"])
        same(printed.TABLE_5_13[model], tables["table_5_13_plastic_exp2"][f"model{model}"])
    for row, start in zip(printed.TABLE_5_10, "ABCD", strict=True):
        same(row, tables["table_5_10_exp1_model1"][start])
    same(printed.TABLE_5_11, tables["table_5_11_exp1_model2"])
    same(printed.TABLE_5_15, tables["table_5_15_exp2_model2"])
    same(printed.TABLE_5_16, tables["table_5_16_mechanical_exp3_model2"])
    same(printed.TABLE_5_17, tables["table_5_17_exp3_prescribed_boundary"])
    same(printed.TABLE_5_22, tables["table_5_22_exp3_literature_thermal"])
    varied = tables["sensitivity_exp3"]
    for ours, theirs in ((printed.TABLE_5_20, "table_5_20_air_varied"), (printed.TABLE_5_21, "table_5_21_clamp_varied")):
        for value, row in ours.items():
            key = round(value - 296.70, 2) if "air" in theirs else value
            assert [1e6 * row["alpha_exp"], *(row[name] for name in SIX[1:])] == pytest.approx(varied[theirs][key])


def test_a_run_begins_behind_the_one_that_it_takes_over(scripts: Any) -> None:
    runs = scripts("thesis_runs")
    names = [run.name for run in runs.RUNS]
    assert len(set(names)) == len(names)
    for run in runs.RUNS:
        assert not run.after or names.index(run.after) < names.index(run.name)
    assert {"exp3", "exp3-model-1"} <= {run.name for run in runs.chosen(["5.4"])}
    assert {run.name for run in runs.chosen(["5.4"])} - {run.name for run in runs.chosen(["5.4"], "coarse")} == {"exp2-model-1-coupled"}
    for run in runs.RUNS:
        load_study(ROOT / "configs" / run.study, [f"mesh={'coarse'}", *run.settings])


def test_artefacts_are_taken_over_once_and_again_where_they_changed(scripts: Any, tmp_path: Path) -> None:
    runs = scripts("thesis_runs")
    source, target = tmp_path / "source", tmp_path / "target"
    source.mkdir()
    target.mkdir()
    (source / "interpolate.h5").write_bytes(b"first")
    runs.take_over(source, target)
    assert (target / "interpolate.h5").read_bytes() == b"first"
    (target / "interpolate.h5").write_bytes(b"made anew by the settings of the target")
    runs.take_over(source, target)
    assert (target / "interpolate.h5").read_bytes().startswith(b"made anew")
    (source / "interpolate.h5").write_bytes(b"second")
    runs.take_over(source, target)
    assert (target / "interpolate.h5").read_bytes() == b"second"


def test_a_failing_run_is_named_with_its_reason(scripts: Any, tmp_path: Path) -> None:
    runs = scripts("thesis_runs")
    wrong = runs.Run("wrong", "5.3", "exp1.yaml", ("kappa=3",), "", (("simulate",),))
    with pytest.raises(StudyError, match=r"run 'wrong', simulate: .*kappa.*log\.txt"):
        runs.execute([wrong], runs.place_of(tmp_path, "coarse"), 1, lambda line: None)
    with pytest.raises(StudyError, match="make thesis MESH=coarse"):
        runs.place_of(tmp_path, "coarse").record("exp1", "verify")


def searched(folder: Path, optima: list[dict[str, float]]) -> Record:
    """A grid search with made-up optima, all with the same f."""
    names = list(optima[0])
    parameters = {n: ParameterResult(v, 0.01 * v, param(n).unit, True, False, v, 0.0, 1e9) for n, v in optima[0].items()}
    starts = [{"failed": False, "converged": True, "optimum": o, "f": 60.0, "at_bound": []} for o in optima]
    summary = {"verdict": "made up", "uniqueness": "valley", "starts": starts, "channels": {"dtheta": {"n": 60}}}
    assert names
    return write_record(folder / "gridsearch.h5", RecordContent("gridsearch", {}, {}, {}, parameters, summary))


def test_starts_of_a_valley_are_told_from_one_optimum(scripts: Any, tmp_path: Path) -> None:
    read, tables = scripts("thesis_read"), scripts("thesis_tables")
    one = {"alpha_exp": 20e-6, "kappa": 100.0, "c0": 2.0, "beta": 1.0}
    record = searched(tmp_path, [one, {name: 2.0 * value for name, value in one.items()}])
    assert read.spread(record) == pytest.approx(dict.fromkeys(one, 1.0))
    assert read.ratio_spread(record, "kappa") == pytest.approx(0.0) and read.f_spread(record) == 0.0
    text = tables.starts_table(record, scripts("thesis_printed").TABLE_5_10, ("kappa",))
    assert "| 2 | 40.000 | 200.00 | 4.0000 | 2.0000 | 100.00 | 1.00000 |" in text
    assert "| thesis 4 | 18.970 | 65.49 | 2.4600 | 0.7500 | 87.32 | f 8.76 K^2 |" in text


def test_agreement_is_computed_and_chooses_the_reason(scripts: Any) -> None:
    agreement = scripts("thesis_agreement")
    why = agreement.Why("one reason", "another reason")
    for here, word, reason in ((-0.2, "Same sign", "one reason"), (0.2, "Differs", "another reason")):
        line = agreement.same_sign("E by", here, -0.14, why).line
        assert line.startswith(f"- **{word}**: E by: here {100 * here:+.2g} %; thesis -14 %.") and line.endswith(reason)
    assert agreement.same_size("E", -0.2, -0.14).line.startswith("- **Agrees**")
    assert agreement.same_sign("E", 8.27, 0.34).word == "Same sign"
    assert agreement.same_size("E", -0.2, -0.14).agrees and not agreement.same_size("E", -0.3, -0.14).agrees
    assert not agreement.same_size("E", 0.14, -0.14).agrees
    assert agreement.same_word("uniqueness", "valley", "valley").agrees and not agreement.same_word("uniqueness", "unique", "valley").agrees
    assert "no (0.3)" in agreement.same_answer("x", (False, "0.3"), (True, "0.1")).line
    curve = [1.0, 2.0, 3.0]
    assert agreement.same_place("f", (curve, [2, 1, 3]), (curve, [2, 1, 3]), why).agrees
    assert not agreement.same_place("f", (curve, [2, 1, 3]), (curve, [3, 2, 1]), why).agrees


def test_no_verdict_is_written_before_the_result() -> None:
    """A page may say that something agrees or differs only through the comparison that computes it."""
    for path in (ROOT / "scripts").glob("thesis_5*.py"):
        text = path.read_text(encoding="utf-8")
        assert not any(word in text for word in ("Agrees", "Differs", "Same sign")), path.name


@pytest.mark.parametrize(("kind", "found", "holds"), [("unique", "unique", True), ("weak", "unique", False), ("valley", "weak", False)])
def test_a_forecast_holds_where_it_names_what_is_found(scripts: Any, tmp_path: Path, kind: str, found: str, holds: bool) -> None:
    """A weak optimum is another forecast than a unique one."""
    before, runs = scripts("thesis_before"), scripts("thesis_runs")
    place = runs.place_of(tmp_path, "quick")
    place.dir_of("planned").mkdir(parents=True)
    write_record(place.dir_of("planned") / f"{before.ARTEFACT}.h5", RecordContent(before.ARTEFACT, {}, {}, {}, {}, {"kind": kind}))
    said = before.foreseen(place, "planned", "a search", found)
    assert said.holds is holds and f"foreseen '{kind}'" in said.measured and said.measured.endswith(f"found '{found}'")


def test_values_and_noise_decide_what_is_said_of_deviations(scripts: Any, tmp_path: Path) -> None:
    agreement = scripts("thesis_agreement")
    record = searched(tmp_path, [{"kappa": 101.0, "beta": 1.0}])
    assert agreement.same_values("both", record, {"kappa": 100.0, "beta": 1.0}, 0.02).agrees
    found = agreement.same_values("both", record, {"kappa": 90.0, "beta": 1.0}, 0.02, agreement.noise_or_not(record, {"kappa": 90.0}))
    assert not found.agrees and "(kappa)" in found.line and "do not hold it" in found.line
    assert "the intervals hold it" in agreement.noise_or_not(record, {"kappa": 100.0}).agrees


def test_every_search_is_foreseen_by_an_analysis_before_the_test(scripts: Any) -> None:
    runs = scripts("thesis_runs")
    names = {run.name for run in runs.RUNS}
    searched_runs = {"exp1", "exp3", *scripts("thesis_54").SEARCHED}
    assert {f"before-{name}" for name in searched_runs} | {"before-exp1-elastic"} <= names
    assert all("--a-priori" in run.commands[0] and not run.after for run in runs.RUNS if run.name.startswith("before-"))


def test_time_of_a_run_is_kept_with_it(scripts: Any, tmp_path: Path) -> None:
    runs, tables = scripts("thesis_runs"), scripts("thesis_tables")
    place = runs.place_of(tmp_path, "coarse")
    run = runs.Run("a", "5.3", "exp1.yaml")
    place.dir_of("a").mkdir(parents=True)
    for cpu in (2.0, 3.0):
        runs._note(place.dir_of("a") / runs.COST, {"command": "run", "wall_s": 4.0, "cpu_s": cpu})
    assert runs.cpu_of([run], place) == 5.0
    assert "in several goes" in tables.document("t", place, [], [])
    runs.note_total(place, {"sections": "5.3 5.4", "from_nothing": True, "jobs": 2, "wall_s": 120.0, "cpu_s": 180.0})
    page = tables.document("t", place, [], [])
    assert "5.3, 5.4 were made from nothing in 2.0 minutes, 2 at a time. They took 3.0 minutes of CPU time" in page
    assert "Later" not in page
    for wall, cpu in ((60.0, 30.0), (30.0, 12.0)):
        runs.note_total(place, {"sections": "5.4", "from_nothing": False, "jobs": 2, "wall_s": wall, "cpu_s": cpu})
    later = "Later calls made anew what had changed since, in 1.5 minutes with 0.7 minutes of CPU time."
    assert later in tables.document("t", place, [], [])
