"""report: every figure that the records allow, the written tables, and nothing left half done."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import verify_fixtures as made
from matplotlib.image import imread

from thermofit.core.errors import StudyError
from thermofit.records.artefact import Record, RecordContent, open_record
from thermofit.records.staging import artefact_path
from thermofit.report.tables import report_text
from thermofit.stages import report, verify
from thermofit.study.study import Study

ALL = ("identify-elastic", "identify-plastic", "identify-thermal")
TRUTH = {name: value for name, value in made.VALUES.items() if name != "kappa"}
SIMULATE = {"truth": {**TRUTH, "kappa": 140.0}}


def prepared(folder: Path, *, infrared: bool = True) -> Study:
    """A verified run, as of a virtual experiment."""
    study = made.study_in(folder, experiment=None, simulate=SIMULATE)
    stages = ALL if infrared else ALL[:2]
    made.write_all(study, made.interpolated(made.coupled_run(), infrared=infrared), *(made.identified(name, made.TRUTH) for name in stages))
    verify.run(study)
    return study


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    return prepared(tmp_path_factory.mktemp("report"))


@pytest.fixture(scope="module")
def record(study: Study) -> Record:
    return report.run(study).record


def test_figures_are_pictures_with_something_on_them(record: Record, study: Study) -> None:
    paths = [Path(path) for path in record.summary["figures"]]
    assert [path.stem for path in paths] == [
        "stress-stretch", "temperature", "force", "residual-over-time", "residual-maps-u", "residual-maps-theta", "residual-rms-maps",
        "objective", "correlation",
    ]  # fmt: skip
    for path in paths:
        assert path.parent == study.run_dir / "figures"
        picture = imread(path)
        assert picture.shape[0] > 300 and picture.shape[1] > 300
        # Not all white, and nothing drawn over the rim: a cut label or legend would leave ink there.
        ink = np.any(picture[:, :, :3] < 0.9, axis=2)
        assert 0.005 < ink.mean() < 0.95, path.stem
        assert not (ink[0].any() or ink[-1].any() or ink[:, 0].any() or ink[:, -1].any()), f"{path.stem}: something is cut off"
    assert not list(study.run_dir.rglob("*.partial"))


def test_text_says_what_was_found(record: Record, study: Study) -> None:
    text = Path(record.summary["report"]).read_text(encoding="utf-8")
    assert Path(record.summary["report"]) == study.run_dir / "report.md"
    cells = [[cell.strip(" |") for cell in line.split(" | ")] for line in text.splitlines() if line.startswith("|")]
    rows = {name: rest for name, *rest in cells}
    assert rows["kappa"] == ["mW/(mm K)", "133", "1.3", "146.3", "0 to 1e+09", "140", "-5.00 %", "-5.3"]
    assert rows["E"][5:] == ["68000", "+0.00 %", "+0.0"]
    channels = open_record(artefact_path(study.run_dir, "verify")).summary["channels"]
    assert rows["theta (information)"][0] == str(channels["theta"]["n"])
    assert "- identify-thermal: remark of identify-thermal" in text
    assert "dic: 3 of 9 rows missing \\| one file" in text
    # Every table has rows of one length, every figure exists.
    for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in block.splitlines()}) == 1, block
    links = re.findall(r"\]\((.*?)\)", text)
    assert len(links) == len(record.summary["figures"]) and all((study.run_dir / link).is_file() for link in links)


def test_fresh_while_its_files_are_there(record: Record, study: Study) -> None:
    assert report.run(study).fresh
    Path(record.summary["figures"][0]).unlink()
    again = report.run(study)
    assert not again.fresh and Path(record.summary["figures"][0]).is_file()


def test_without_infrared(tmp_path: Path) -> None:
    made_record = report.run(prepared(tmp_path, infrared=False)).record
    names = {Path(path).stem for path in made_record.summary["figures"]}
    assert "temperature" not in names and "residual-maps-theta" not in names and "residual-rms-maps" in names


def test_measured_experiment_has_no_truth(study: Study, tmp_path: Path) -> None:
    records = {name: open_record(artefact_path(study.run_dir, name)) for name in ("interpolate", *ALL, "verify")}
    known, unknown = report_text(study, records, ()), report_text(made.study_in(tmp_path), records, ())
    assert "in standard uncertainties" in known and "virtual experiment" in known
    assert "in standard uncertainties" not in unknown and "virtual" not in unknown


def test_missing_verify_names_its_command_and_leaves_a_page(tmp_path: Path) -> None:
    study = made.study_in(tmp_path)
    made.write_all(study, made.interpolated(made.coupled_run()), made.identified("identify-elastic", made.TRUTH))
    with pytest.raises(StudyError, match=r"`thermofit verify study\.yaml`.*report\.html shows what there is"):
        report.run(study)
    found = json.loads((study.run_dir / "report.json").read_text(encoding="utf-8"))
    assert found["verdict"]["open"][0].startswith("the last command ended with an error: artefact")
    assert "verify" in [s["stage"] for s in found["stages"] if s["state"] == "missing"]


def test_page_has_truth_and_mesh_of_the_study(record: Record, study: Study) -> None:
    pages = record.summary["pages"]
    assert {Path(p).name for p in pages.values()} == {"report.html", "report.json", "methods.md", "methods.bib"}
    found = json.loads(Path(pages["json"]).read_text(encoding="utf-8"))
    kappa = next(p for p in found["parameters"] if p["name"] == "kappa")
    assert (kappa["true"], kappa["value"], kappa["start"]) == (140.0, 133.0, pytest.approx(146.3))
    assert found["verdict"]["sentence"] == record.summary["sentence"]
    assert found["verdict"]["next_step"] == "thermofit close-loop study.yaml"


def test_what_has_run_beside_the_chain_makes_the_page_anew(study: Study) -> None:
    report.run(study)
    made.write_all(study, RecordContent("identifiability", {}, {}, {}, {}, {"verdict": "unique"}))
    assert not report.run(study).fresh and report.run(study).fresh
    artefact_path(study.run_dir, "identifiability").unlink()


def test_a_file_in_the_way_is_one_sentence(study: Study) -> None:
    figures, aside = study.run_dir / "figures", study.run_dir / "aside"
    figures.rename(aside)
    figures.write_text("no folder", encoding="utf-8")
    try:
        with pytest.raises(StudyError, match="expected a writable folder"):
            report.run(study, force=True)
    finally:
        figures.unlink()
        aside.rename(figures)


def test_figures_may_be_pdf_and_svg_too(record: Record, study: Study) -> None:
    """Text and lines that scale, beside the same pictures; the second time nothing is drawn, the same figure is the same file."""
    assert len(record.summary["figures"]) > 5
    with pytest.raises(StudyError, match=r"did you mean 'pdf'\?"):
        report.run(study, also=("pfd",))
    made_anew = report.run(study, also=("pdf", "svg"))
    folder = study.run_dir / "figures"
    for path in map(Path, made_anew.record.summary["figures"]):
        assert (folder / f"{path.stem}.pdf").read_bytes().startswith(b"%PDF")
        assert "<svg" in (folder / f"{path.stem}.svg").read_text(encoding="utf-8")
    before = {path: path.read_bytes() for path in folder.glob("*.[ps][dv][fg]")}
    assert report.run(study, also=("pdf", "svg")).fresh and report.run(study).fresh
    report.run(study, also=("pdf", "svg"), force=True)
    assert {path: path.read_bytes() for path in before} == before
