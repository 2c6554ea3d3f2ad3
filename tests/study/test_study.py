"""The study file: what a user writes, and every sentence that a user gets for a mistake."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from thermofit.core.errors import StudyError
from thermofit.core.experiment import ForceRecord, MeasuredTest, Specimen
from thermofit.core.parameters import LAW
from thermofit.law.hardening.catalogue import Hardening, hardening_laws
from thermofit.study.section import PRESETS, MeshSize, SheetSize, recorded_mesh
from thermofit.study.study import Study, json_schema, load_study
from thermofit.study.template import template

ROOT = Path(__file__).resolve().parents[2]
SMALL = "name: small\nexperiment: raw\n"
VIRTUAL = "name: v\nsimulate: {truth: {E: 7e4, theta_air: 297.4, theta_clamp: 296.7}}\n"


@pytest.fixture
def write(tmp_path: Path):
    """Writes a study file and returns its path."""

    def write_text(text: str) -> Path:
        path = tmp_path / "study.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write_text


@pytest.fixture
def experiment() -> MeasuredTest:
    import numpy as np

    specimen = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
    record = ForceRecord(np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    return MeasuredTest(Path("raw"), specimen, 297.55, 296.75, record, None, None, None)


def message(path: Path, *overrides: str) -> str:
    """The one sentence of a study that must not load."""
    with pytest.raises(StudyError) as caught:
        load_study(path, overrides)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_the_smallest_study_has_every_default(write) -> None:
    study = load_study(write(SMALL))
    assert (study.model, study.mesh, study.virtual) == (2, "full", False)
    assert study.mesh_size == MeshSize(n_x=12, n_y=80, n_z=4)
    assert study.stages.elastic.free == ("E", "nu") and study.stages.elastic.window == "auto"
    assert study.stages.thermal.coupling == "one-way" and study.stages.plastic.coupling == "full"
    assert study.stages.thermal.channels["dtheta"].weight == "sigma"


def test_template_loads_as_it_stands(write) -> None:
    study = load_study(write(template()))
    for name in ("elastic", "plastic", "thermal"):
        study.stage(name)


@pytest.mark.parametrize("look", ["no data", (7.1e4, 251.0, 0.23)], ids=["unseen", "seen"])
@pytest.mark.parametrize("law", hardening_laws(), ids=lambda law: law.name)
def test_template_of_every_hardening_law(write, law: Hardening, look: str | tuple[float, float, float]) -> None:
    """Stage plastic frees what the law has, with starts and bounds that the law gives, and M_y0 starts below the stress that was seen."""
    text = template(look=look, law=law)
    study = load_study(write(text))
    assert study.hardening_law == law.name and (f"\nhardening: {law.name} " in text) == (law.name != "model2")
    assert study.stage("plastic").free == (*law.fitted, "F")
    given = law.file.METALS if isinstance(look, str) else law.file.search(*look[1:])
    for name, (start, low, high) in given.items():
        setting = study.parameters[name]
        assert (setting.start, *setting.bounds) == pytest.approx((start, low, high), rel=0.06), "two digits"
    assert isinstance(look, str) or study.parameters["M_y0"].start < look[1]
    assert ", ".join(["E", *given]) + ": f" in text


def test_keys_that_the_template_comments_out_are_the_defaults(write) -> None:
    """Uncommented, the template still loads, and what it shows as defaults are the defaults."""
    text = re.sub(r"^( *)# ", r"\1", template(), flags=re.MULTILINE)
    shown, plain = load_study(write(text)), load_study(write(template()))
    sections = ("model", "mesh", "evaluation", "force", "ir", "noise", "numerics", "stages")
    assert shown.config_of(*sections) == plain.config_of(*sections)
    alone = {"necking"}  # a study of its own
    assert set(yaml.safe_load(text)) | alone == set(json_schema()["properties"]), "the template misses a section"
    assert all(f"## {key}:" in text for key in alone)
    assert shown.simulate is not None
    truth_only = load_study(write(SMALL), [f"simulate.truth={json.dumps(shown.simulate.truth)}"])
    assert shown.simulate == truth_only.simulate


def test_paths_relative_to_study_and_to_current_directory(write, tmp_path, monkeypatch) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    study = load_study(write(SMALL))
    assert study.source == tmp_path / "study.yaml"
    assert study.experiment == tmp_path / "raw"
    assert study.run_dir == elsewhere / "runs" / "small"
    assert load_study(write(SMALL), ["run_dir=/r"]).run_dir == Path("/r")
    assert load_study(write(SMALL), ["experiment=/data/B9"]).experiment == Path("/data/B9")


def test_virtual_study_reads_what_it_wrote(write) -> None:
    study = load_study(write(VIRTUAL), ["run_dir=/r"])
    assert study.virtual and study.experiment == Path("/r/raw")
    assert study.truth_parameters()["theta_ref"] == 296.7
    assert not load_study(write(VIRTUAL), ["experiment=measured"]).virtual


def test_environment_in_paths(write, monkeypatch) -> None:
    path = write("name: a\nexperiment: ${RIG_DATA}/x\n")
    monkeypatch.setenv("RIG_DATA", "/rig")
    assert load_study(path).experiment == Path("/rig/x")
    monkeypatch.delenv("RIG_DATA")
    assert "RIG_DATA is not set" in message(path) and "export RIG_DATA=" in message(path)


def test_exponents_without_a_point_are_numbers(write) -> None:
    study = load_study(write(SMALL + "parameters: {alpha_exp: 23e-6, E: 7E4}\n"))
    assert study.parameters == {"alpha_exp": 23e-6, "E": 7e4}


def test_overrides_are_yaml_and_leave_anchors_alone(write) -> None:
    path = write(
        SMALL + "parameters: {E: 7e4, nu: .3}\nstages:\n  elastic: &s {free: [E], channels: {du: {}}, window: all}\n  plastic: *s\n"
    )
    study = load_study(path, ["mesh=coarse", "stages.plastic.method=nelder-mead", "stages.plastic.free=[nu, E]", "numerics.threads=1"])
    assert study.mesh_size == MeshSize(n_x=6, n_y=40, n_z=2)
    assert study.stages.plastic.method == "nelder-mead" and study.stages.plastic.free == ("nu", "E")
    assert study.stages.elastic.method == "least-squares" and study.numerics.threads == 1


STARTS = "parameters: {E: {start: 6e4, bounds: [3e4, 15e4], scale: 5e4}, nu: 0.3}\n"
SENTENCES = [
    ("stages.elastic.fre=[E]", "key 'stages.elastic.fre' is not known; did you mean 'free'?"),
    ("Mesh=full", "did you mean 'mesh'?"),
    ("mesh=coarze", "key 'mesh' is 'coarze'; expected 'coarse', 'full' or 'sheet'"),
    ("mesh={n_x: 2, n_y: 0, n_z: 1}", "key 'mesh.n_y' is 0; expected at least 1"),
    ("model=3", "key 'model' is 3; expected 1 or 2"),
    ("model=true", "key 'model' is true; expected 1 or 2"),
    ("name=a b", "key 'name' is 'a b'; expected a text of the form"),
    ("numerics.threads=1.5", "expected a whole number"),
    ("numerics.threads=true", "expected a whole number"),
    ("numerics.max_time_step='5'", "key 'numerics.max_time_step' is '5'; expected a number"),
    ("evaluation.reference_time=.nan", "expected a finite number"),
    ("evaluation.displacement_times=[2, 1]", "is not increasing"),
    ("stages.elastic.window=[3]", "key 'stages.elastic.window' ends before entry 2"),
    ("stages.elastic.window=[3, 3]", "key 'stages.elastic.window' is not increasing"),
    ("stages.elastic.window=5", "expected auto, all or [t0, t1]"),
    ("stages.elastic.free=[E, E]", "names E more than once"),
    ("stages.elastic.free=[kapa]", "did you mean 'kappa'?"),
    ("stages.elastic.channels={dux: {}}", "key 'stages.elastic.channels.dux'"),
    ("stages.elastic.channels={dtheta: {weight: {x: 1, y: 1}}}", "this channel has no components"),
    ("stages.elastic.channels={du: {weight: {x: 0, y: 0}}}", "at least one positive weight"),
    ("stages.elastic.channels={du: {weight: -1}}", "channels.du.weight' is -1; expected more than 0"),
    ("stages.thermal={}", "key 'parameters.alpha_exp' is missing, but stage thermal identifies it"),
    ("material_axes.angle=45", "key 'material_axes.angle' is 45 degrees; expected a multiple of 90"),
    ("parameters.Ee=3", "did you mean 'E'?"),
    ("parameters.E=abc", "key 'parameters.E' is 'abc'; expected a number or a section"),
    ("parameters.E.strat=3", "key 'parameters.E.strat' is not known; did you mean 'start'?"),
    ("parameters.E.start=2e5", "key 'parameters.E.start' is 200000, outside its bounds [30000, 150000]"),
    ("parameters.E.bounds=[15e4, 3e4]", "expected the lower bound first"),
    ("parameters.E.bounds=[0, 15e4]", "may narrow the physical bounds, not widen them"),
    ("parameters.nu=0.5", "key 'parameters.nu' is 0.5; expected 0 to 0.499 (Poisson's ratio)"),
    ("parameters.beta=-0.1", "second law (4.23)"),
    ("parameters.theta_air=24.4", "was 24.4 degC = 297.55 K meant?"),
    ("parameters.M_yinf=100", "key 'parameters.M_yinf' is 100 MPa; expected more than M_y0 = 130 MPa"),
    ("parameters.F=0", "key 'parameters.F' is 0; expected 0.001 to 100"),
    ("simulate={truth: {M_y0: 300, M_yinf: 300}}", "key 'simulate.truth.M_yinf' is 300 MPa"),
    ("simulate={truth: {theta_air: 20}}", "key 'simulate.truth.theta_air' is 20 K"),
    ("simulate={truth: {}, programme: [{hodl: 3}]}", "key 'simulate.programme.0.hodl' is not known; did you mean 'hold'?"),
    ("simulate={truth: {}, programme: [{crosshead_to: 3, rate: 0}]}", "key 'simulate.programme.0.rate' is 0"),
    ("simulate={truth: {}, programme: [{crosshead_to: 3}]}", "key 'simulate.programme.0.rate' is missing"),
    ("simulate={truth: {}, programme: [{hold: 3, rate: 1}]}", "key 'simulate.programme.0.rate' is not known"),
    ("simulate={truth: {}, programme: [{force_to: -5, rate: -1}]}", "force_to' is -5; expected a number >= 0 (a sheet buckles"),
    ("simulate={truth: {}, programme: []}", "key 'simulate.programme' is []; expected at least 1 entries"),
    ("gridsearch={stage: elastic, starts: [{E: 7e4}, {E: 1e4}]}", "key 'gridsearch.starts.1.E' is 10000; expected 30000 to 150000"),
    ("gridsearch={stage: thermal}", "key 'gridsearch' holds no starts; list them under 'starts', or let them be drawn"),
    ("gridsearch={stage: thermal, draw: {number: 4}}", "key 'gridsearch.draw.seed' is missing"),
    (
        "gridsearch={stage: thermal, draw: {number: 4, seed: 1, within: {kappa: [9, 8]}}}",
        "key 'gridsearch.draw.within.kappa' is [9, 8]; expected the lower end first",
    ),
    ("sensitivity={stage: thermal, quantity: thicknes, values: [1.0]}", "key 'sensitivity.quantity' names nothing that can be prescribed"),
    ("sensitivity={stage: thermal, quantity: weight.v, values: [1.0]}", "there is no channel v"),
    ("sensitivity={stage: elastic, quantity: thickness, values: [0.0]}", "key 'sensitivity.values' is 0; expected a positive number for"),
    ("gridsearch={stage: elastic, starts: [{M_y0: 300}]}", "key 'gridsearch.starts.0.M_yinf'"),
    (
        "sensitivity={stage: thermal, quantity: kappa, values: [3]}",
        "key 'sensitivity.quantity' is kappa, which stages.thermal.free identifies",
    ),
    ("sensitivity={stage: thermal, quantity: theta_air, values: [23]}", "key 'sensitivity.values' is 23 K"),
    ("ir.landmarks.length.p1=3", "key 'ir.landmarks.length.p1' is 3; expected a pixel [row, col]"),
    ("experiment=null", "key 'experiment' is missing"),
    ("mesh", "expected key=value"),
    ("parameters.nu.start.x=1", "key 'parameters.nu' is 0.3 in the study, not a section"),
    ("mesh=[1", "line 1"),
    ("mesh={n_x: 100, n_y: 1000, n_z: 20}", "asks for 2123121 nodes; expected at most 200000"),
    ("mesh={sheet: {n_x: 12, n_y: 80, n_z: 2}}", "key 'mesh.sheet.n_z' is 2; expected 1"),
    ("mesh={sheet: {n_x: 12}}", "key 'mesh.sheet.n_y' is missing"),
    ("mesh={sheet: {n_x: 12, n_y: 80}, n_z: 1}", "key 'mesh.n_z' is not known; known are sheet"),
    ("mesh=3", "key 'mesh' is 3; expected coarse, full, sheet, {n_x: .., n_y: .., n_z: ..} or {sheet: {n_x: .., n_y: ..}}"),
    ("run_dir=~nobody-of-that-name/a", "key 'run_dir' is '~nobody-of-that-name/a', but the home folder of that user is not known"),
    ('run_dir="a\\0b"', "key 'run_dir' is 'a\\x00b', which holds a zero byte"),
    ("mesh=&a {n_x: *a}", "line 1: an alias stands for a section that holds it"),
]


@pytest.mark.parametrize("key", ["mesh", "diagnosis.mesh", "evaluation.nodes"])
def test_a_mesh_from_a_file_is_no_sheet(write, key: str) -> None:
    text = message(write(SMALL + STARTS), "geometry={shape: file, file: a.inp, unit: mm}", f"{key}=sheet")
    assert f"key '{key}' asks for a sheet, but the mesh of geometry.file stays as it is; leave the key out" in text


def test_sheets_by_word_and_by_size(write) -> None:
    sizes = [load_study(write(SMALL), [f"mesh={mesh}"]) for mesh in ("sheet", "{sheet: {n_x: 6, n_y: 40}}")]
    assert [one.mesh_size for one in sizes] == [SheetSize(n_x=12, n_y=80), SheetSize(n_x=6, n_y=40)]
    assert [one.mesh_size.body for one in sizes] == [PRESETS["full"], PRESETS["coarse"]]
    assert all(recorded_mesh(one.config_of("mesh")["mesh"]) == one.mesh_size for one in sizes), "as a record keeps it"
    assert PRESETS["sheet"] != MeshSize(n_x=12, n_y=80, n_z=1), "a body with one layer is refined through its thickness"


@pytest.mark.parametrize(("override", "expected"), SENTENCES, ids=[o for o, _ in SENTENCES])
def test_one_sentence_for_a_mistake(write, override: str, expected: str) -> None:
    assert expected in message(write(SMALL + STARTS), override)


def test_the_sentence_names_file_and_override(write) -> None:
    path = write(SMALL + "mesh: coarze\n")
    assert message(path).startswith(f"{path}: key 'mesh'")
    assert " with mesh=fool: key 'mesh'" in message(path, "mesh=fool")
    assert message(write(SMALL + "mesh: coarze\nmodel: 5\n")).endswith("(and 1 more)")


def test_yaml_mistakes_name_the_line(write, tmp_path) -> None:
    assert "begins in line 3)" in message(write("name: a\nexperiment: raw\nmesh: [1, 2\n"))
    assert "study.yaml, line 2:" in message(write("name: a\n\tmesh: full\n"))
    assert "study.yaml, line 4: the key 'mesh' is given twice" in message(write(SMALL + "mesh: full\nmesh: coarse\n"))
    assert "line 3" in message(write(SMALL + "1: 2\n")) and "is not a text" in message(write(SMALL + "1: 2\n"))
    assert "found nothing" in message(write("# empty\n"))
    assert "found a list" in message(write("- a\n"))
    assert "thermofit new" in message(tmp_path / "nowhere.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"name: \xff\xfe\n")
    assert "UTF-8" in message(tmp_path / "latin.yaml")
    assert "directory" in message(tmp_path)


def test_parameters_from_study_and_experiment(write, experiment) -> None:
    study = load_study(write(SMALL + STARTS))
    start = study.start_parameters(experiment)
    assert (start["E"], start["nu"], start["G"]) == (6e4, 0.3, 0.5)
    assert (start["theta_air"], start["theta_clamp"], start["theta_ref"]) == (297.55, 296.75, 296.75)
    assert study.bounds("E") == (3e4, 15e4) and study.scale("E") == 5e4
    nu = next(p for p in LAW if p.name == "nu")
    assert study.bounds("nu") == (nu.lower, nu.upper) and study.scale("nu") == nu.scale
    given_temperature = load_study(write(SMALL), ["parameters.theta_clamp=300"]).start_parameters(experiment)
    assert (given_temperature["theta_air"], given_temperature["theta_ref"]) == (297.55, 300.0)
    with pytest.raises(StudyError, match=r"parameters\.theta_air' is missing"):
        study.start_parameters(None)
    with pytest.raises(StudyError, match="not known"):
        study.bounds("Young")


def test_stage_that_is_not_listed_needs_its_starts_when_it_runs(write) -> None:
    study = load_study(write(SMALL + STARTS))
    assert study.stage("elastic").free == ("E", "nu")
    with pytest.raises(StudyError, match=r"parameters\.M_y0' is missing"):
        study.stage("plastic")
    with pytest.raises(StudyError, match="did you mean 'thermal'"):
        study.stage("termal")


def test_specimen_override(write, experiment) -> None:
    specimen = load_study(write(SMALL), ["specimen.thickness=1.19"]).specimen_of(experiment.specimen)
    assert (specimen.thickness, specimen.gauge_width) == (1.19, 25.0)


def test_config_is_json_with_defaults_filled_in(write) -> None:
    study = load_study(write(SMALL + STARTS))
    config = study.config_of("mesh", "stages.elastic", "parameters", "numerics")
    assert json.loads(json.dumps(config)) == config
    assert config["stages.elastic"]["tolerance"] == 1e-5 and config["parameters"]["E"]["bounds"] == [3e4, 15e4]
    assert set(config) == {"mesh", "stages.elastic", "parameters", "numerics"}
    with pytest.raises(KeyError):
        study.config_of("stages.elstic")


def test_study_is_read_only(write) -> None:
    study = load_study(write(SMALL))
    with pytest.raises(ValueError, match="frozen"):
        study.mesh = "coarse"  # type: ignore[misc]
    assert isinstance(study, Study)


def test_published_schema_is_current() -> None:
    published = json.loads((ROOT / "docs" / "study.schema.json").read_text(encoding="utf-8"))
    assert published == json_schema(), "run scripts/write_schema.py"


def test_reading_a_study_starts_quickly() -> None:
    """Neither numba nor scipy nor h5py is needed to say that a key is misspelt."""
    code = "import sys, thermofit.study.study; print([m for m in ('numba', 'scipy', 'h5py', 'matplotlib') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


@settings(max_examples=200)
@given(st.text(alphabet=st.sampled_from(list("name:exprimt ab\n-[]{}&*#!'\"0123.e|>?,\t%")), max_size=60), st.integers(0, 2000))
def test_garbage_is_a_study_error_or_a_study(tmp_path_factory, garbage: str, place: int) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.yaml"
    text = template()
    place = place % len(text)
    for mutated in (text[:place] + garbage + text[place + len(garbage) :], garbage):
        path.write_text(mutated, encoding="utf-8")
        try:
            load_study(path)
        except StudyError as error:
            assert "\n" not in str(error)


leaf = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
tree = st.recursive(
    leaf, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["x", "E", "weight", "hold"]), inner, max_size=3)
)
KEYS = """
mesh
specimen
parameters
parameters.E
evaluation
evaluation.window
evaluation.displacement_times
ir
ir.landmarks
stages
stages.elastic
stages.elastic.window
stages.elastic.channels.du.weight
stages.elastic.free
gridsearch
simulate
simulate.programme
simulate.truth
sensitivity
sensitivity.values
name
experiment
run_dir
numerics.threads
""".split()


@settings(max_examples=300)
@given(st.sampled_from(KEYS), tree)
@example("stages.elastic.free", ["\n"])
def test_any_value_at_any_key_is_a_study_error_or_a_study(tmp_path_factory, key: str, value: object) -> None:
    path = tmp_path_factory.getbasetemp() / "value.yaml"
    path.write_text(SMALL, encoding="utf-8")
    try:
        load_study(path, [f"{key}={yaml.safe_dump(value)}"])
    except StudyError as error:
        assert "\n" not in str(error)


def test_results_go_into_no_folder_of_other_things(write, tmp_path: Path) -> None:
    """Elsewhere a study may write into a new folder and into one of results; where the command line says so, anywhere."""
    other, key = tmp_path.parent / f"{tmp_path.name}-other", "run_dir: "
    path = write(SMALL + key + str(other) + "\n")
    assert load_study(path).run_dir == other
    other.mkdir()
    assert load_study(path).run_dir == other
    (other / "letters.txt").touch()
    assert "a folder of other things (1, among them letters.txt)" in message(path)
    assert load_study(path, [f"run_dir={other}"]).run_dir == other
    (other / "interpolate.h5").touch()
    assert load_study(path).run_dir == other
