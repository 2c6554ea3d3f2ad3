"""The page of a run: one valid file without a network, whose data parse, in which nothing of the data is executed."""

from __future__ import annotations

import base64
import json
import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import report_runs as made
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.core.errors import StudyError
from thermofit.records.artefact import Dataset, RecordContent, open_record
from thermofit.report.html.captions import CAPTIONS
from thermofit.report.html.content import Report, report_schema
from thermofit.report.html.gather import report_of
from thermofit.report.html.maps import field_of_rows, pairs, raster
from thermofit.report.html.methods import methods_text, references
from thermofit.report.html.page import write_report
from thermofit.report.html.run_folder import read_run
from thermofit.report.html.views import BUDGET, packed, unpacked, views_of

VOID = {"meta", "input", "br", "img", "link", "hr"}
SCHEMA = Path(__file__).resolve().parents[2] / "docs" / "report.schema.json"


class Page(HTMLParser):
    """Elements of a page; `wrong` lists end tags that close nothing, and what is never closed."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.wrong: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, list[str]] = {}
        self.feed(text)
        self.close()
        self.wrong += self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if self.open and self.open[-1] == tag:
            self.open.pop()
        else:
            self.wrong.append(f"/{tag} in {self.open[-3:]}")

    def handle_data(self, data: str) -> None:
        if self.open:
            self.texts.setdefault(self.open[-1], []).append(data)

    def values(self, name: str) -> list[str]:
        return [a[name] or "" for _, a in self.elements if name in a]


def page_of(folder: Path) -> tuple[str, Page, dict[str, Any]]:
    """Text of the page, its elements, and what its viewer draws."""
    text = write_report(folder).html.read_text(encoding="utf-8")
    page = Page(text)
    views = json.loads(re.search(r'<script type="application/json" id="views">(.*?)</script>', text, re.DOTALL)[1])  # type: ignore[index]
    return text, page, views


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made.whole_run(tmp_path_factory.mktemp("page") / "a-run")


def test_the_answer_is_one_sentence(run: Path) -> None:
    _, page, _ = page_of(run)
    sentence = "".join(page.texts["h1"])
    assert re.fullmatch(
        r"The model lacks lamp \(or its like, latent_heat\); with it, the error on unseen data falls "
        r"from \d\.\d\d to (?:0\.9|1\.0)\d times the noise \(temperature rise\)\.",
        sentence,
    )
    content = Report.model_validate_json((run / "report.json").read_text(encoding="utf-8"))
    assert content.verdict.sentence == sentence and content.verdict.asked == "loop" and content.verdict.trustworthy
    assert content.verdict.open == ["which of them it is: lamp (added) or latent_heat"]


def test_page_is_valid_and_alone(run: Path) -> None:
    text, page, _ = page_of(run)
    assert page.wrong == []
    assert [n for n, count in Counter(page.values("id")).items() if count > 1] == []
    assert {h.removeprefix("#") for h in page.values("href")} <= set(page.values("id"))
    assert all(h.startswith("#") for h in page.values("href")) and not page.values("src")
    without_data = re.sub(r'(<script type="application/json" id="views">).*?(</script>)', r"\1\2", text, flags=re.DOTALL)
    assert not re.search(r"https?:|[\"'(]//[a-z]|@import|url\(|<link|<iframe", without_data, re.IGNORECASE)
    policy = next(a["content"] for _, a in page.elements if a.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None and policy.startswith("default-src 'none'; script-src 'sha256-") and "unsafe-inline' 'un" not in policy
    assert len(text) < 15e6


def test_every_figure_has_four_lines(run: Path) -> None:
    _, page, _ = page_of(run)
    shown = [i for i in page.values("id") if i in CAPTIONS]
    assert {"bars", "maps", "curves", "ladder", "smallest", "decide", "parameters", "camera", "phases", "correlation", "methods"} <= set(
        shown
    )
    assert sum(a.get("class") == "four" for _, a in page.elements) == len(shown)
    assert page.texts["dt"].count("Good") == page.texts["dt"].count("Then") == len(shown)
    assert all(min(len(c.shown), len(c.good), len(c.bad), len(c.todo)) > 10 for c in CAPTIONS.values())


def test_local_balances_stand_in_the_page_with_their_figure(tmp_path: Path) -> None:
    row = {
        **{
            "balance": "heat",
            "channel": "dtheta",
            "experiment": None,
            "where": "inside",
            "unit": "mW/mm^3",
            "chi2": 812.0,
            "degrees": 66.5,
        },
        "block": {"y_mm": [5.0, 15.0], "when_s": [38.0, 62.0], "value": 0.064, "sigma": 0.003, "chi2_drop": 700.0},
        "closes_with": {"parameter": "kappa", "value": 144.0, "sigma": 22.0, "fitted": 18.0},
    }
    drift = {
        "words": "kappa wants to fall with temperature",
        "slope": -0.2,
        "sigma": 0.01,
        "unit": "mW/(mm K) per K",
        "z": -20.0,
        "alike": [],
    }
    said = {
        "local_balances": {"where": "inside", "maps": [row], "without": [made.HOSTILE], "figure": None},
        "drift": {"asked": 60, "found": [drift], "without": ""},
    }
    folder = made.whole_run(tmp_path / "run", **said)
    loop = open_record(folder / "close-loop.h5")
    z = np.random.default_rng(1).normal(size=(9, 4))
    z[3, 2], z[8, 0] = 9.0, np.nan
    maps = {
        "balance/heat/z": Dataset(z, "1", ("window", "place")),
        "balance/heat/time": Dataset(np.linspace(2.0, 70.0, 9), "s", ("window",)),
        "balance/heat/y": Dataset(np.linspace(-15.0, 15.0, 4), "mm", ("place",)),
        "balance/heat/threshold": Dataset(np.array([3.6]), "1", ("map",)),
    }
    data = {name: loop[name] for name in loop.names} | maps
    made.write(folder, RecordContent("close-loop", loop.config, {}, data, loop.parameters, loop.summary))
    _, page, _ = page_of(folder)
    points = " ".join(page.texts["li"])
    assert (
        "0.064 +- 0.003 mW/mm^3 at y = 5 to 15 mm from 38 to 62 s" in points
        and "closes with kappa = 144 +- 22, where the fit has 18" in points
    )
    assert "kappa wants to fall with temperature: -0.2 +- 0.01 mW/(mm K) per K" in points and made.HOSTILE in points
    (picture,) = page.values("src")
    assert picture.startswith("data:image/png;base64,") and base64.b64decode(picture.partition(",")[2]).startswith(b"\x89PNG")
    assert {"significance", "drift"} <= set(page.values("id")) and page.wrong == []


def test_maps_before_and_after_are_what_the_loop_left(run: Path) -> None:
    _, _, views = page_of(run)
    (test,) = views["tests"]
    theta = next(m for m in test["maps"] if m["channel"] == "dtheta")
    order = [test["grids"][theta["grid"]]["xy"].index([x, y]) for x, y in made.XY.tolist()]
    for side, amount in (("before", 8.0), ("after", 0.0)):
        seen, true = unpacked(theta[side])[:, order], made.residuals(amount, 1)["dtheta"][:, :, 0]
        np.testing.assert_allclose(seen, true, atol=1e-3)
    assert theta["words"] == ["without an added effect", "with lamp"] and theta["noise"] == 0.02
    assert {m["label"] for m in test["maps"]} == {
        "temperature rise",
        "displacement across the load (x)",
        "displacement along the load (y)",
    }


@pytest.mark.parametrize("before", [True, False])
def test_without_rows_of_the_first_model_the_verified_one_stands_for_it(tmp_path: Path, before: bool) -> None:
    words = {pair.words[0] for pair in pairs(read_run(made.whole_run(tmp_path, before=before)))}
    assert words == {"without an added effect" if before else "the model of the stages, not fitted jointly"}


def test_curves_of_a_point_show_its_stretch_and_rise(run: Path) -> None:
    _, _, views = page_of(run)
    fields = views["tests"][0]["fields"]
    stretch = unpacked(fields["u"]["stretch_model"])
    expected = 1.0 + 0.1 * np.clip((made.TIME - 6.0) / 54.0, 0.0, 1.0)
    assert np.nanmax(np.abs(stretch - expected[:, None])) < 1e-4
    assert fields["u"]["stress"][-6] == pytest.approx(np.interp(made.TIME[-6], [6.0, 60.0], [0.0, 5000.0]) / 30.0, rel=2e-2)
    assert fields["theta"]["reference_model"][0] == pytest.approx(297.0, abs=1e-3)
    assert np.isnan(unpacked(fields["u"]["value"])[made.LOST]).all()


def test_ladder_says_why(run: Path) -> None:
    rungs = {" + ".join(r.effects): r for r in report_of(read_run(run)).ladder}
    assert (*rungs,)[0] == "lamp" and (*rungs,)[-1] == "radiation"
    assert (rungs["lamp"].state, rungs["lamp"].why, rungs["lamp"].gain) == ("added", "added in round 1", 0.26)
    assert (rungs["ir_drift"].state, rungs["ir_drift"].why, rungs["ir_drift"].gain) == ("refused", "less than lamp", 0.1)
    assert rungs["bending"].why == "beside what was added: z 0.1 is below 2.8"
    assert rungs["radiation"].state == "beyond its bounds"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"accepted": [], "rounds": []}, "Nothing is missing down to the amplitudes"),
        ({"accepted": [], "rounds": [], "trustworthy": False, "doubts": ["d"]}, "No listed effect explains what the model leaves"),
        ({"accepted": ["lamp", "ir_drift"]}, "lacks lamp (or its like, latent_heat) and ir_drift; with them, the error"),
    ],
)
def test_other_answers(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    assert words in report_of(read_run(made.whole_run(tmp_path, **changes))).verdict.sentence


def test_a_diagnosis_points_but_adds_nothing(tmp_path: Path) -> None:
    loop = made.looped()
    keep = ("ranking", "channels", "lack_of_fit", "unfelt", "not_asked", "held_out")
    summary = {key: loop.summary[key] for key in keep} | {
        "verdict": "points to lamp",
        "trustworthy": False,
        "doubts": ["dtheta"],
        "remarks": [],
    }
    diagnosis = replace(loop, stage="diagnose", summary=summary)
    content = write_report(made.write(tmp_path, made.interpolated(), made.verified(), diagnosis)).content
    assert content.verdict.sentence == (
        "The residual points to lamp, which would lower the error on unseen data by 25 %; nothing has been added yet."
    )
    assert content.verdict.next_step == "thermofit close-loop STUDY.yaml" and content.bars[0].floor == pytest.approx(0.1)
    assert all(pair.after is None for pair in pairs(read_run(tmp_path)))


def test_phases_of_both_models_stand_side_by_side(run: Path) -> None:
    rows = report_of(read_run(run)).phases
    assert len(rows) == 2 * len(made.PHASES)
    assert all((r.verified, r.last, r.floor) == (2.0, 1.0, pytest.approx(0.1)) for r in rows)


def test_parameters_beside_an_unlisted_heat_are_on_the_page(tmp_path: Path) -> None:
    values = {"kappa": {"value": 141.5, "sigma": 2.5, "unit": "mW/(mm K)", "joint_fit": 97.25}}
    unlisted = {"channel": "dtheta", "where": None, "when_s": None, "excess_share": 0.1, "parameters": None}
    beside = {
        "values": values,
        "failed": "",
        "spot": {"y_mm": -1.302, "spread_mm": None, "velocity_mm_per_s": 0.1234, "velocity_sigma": 0.0007, "at_s": 105.52},
        "second": {"jaws": 0.6, "offset": 0.01},
        "held": {"rate_power.m": 0.25},
        "untold": ["it counts as exact"],
    }
    told, failed, alone = (tmp_path / name for name in ("told", "failed", "alone"))
    made.whole_run(told, unlisted={**unlisted, "parameters": beside}, trustworthy=False)
    _, page, _ = page_of(told)
    second = "standard errors hold that there may be another history beside it: a change of the temperature of the jaws"
    held = "rate_power.m = 0.25: held beside it; standard errors hold what other values would change"
    travels = "taken for one spot that travels at 0.123 +- 0.0007 mm/s, and is at y = -1.3 mm at 105.5 s"
    assert {second, held, travels, "it counts as exact"} <= set(page.texts["p"])
    assert "Parameters beside it" in page.texts["h3"] and {"141.5", "2.5", "97.25"} <= set(page.texts["td"]) and page.wrong == []
    made.whole_run(failed, unlisted={**unlisted, "parameters": {"values": {}, "failed": "a run failed", "second": {}}}, trustworthy=False)
    _, page, _ = page_of(failed)
    assert "a run failed; those that act on temperatures have no standard errors" in page.texts["p"] and "141.5" not in page.texts["td"]
    made.whole_run(alone, unlisted={**unlisted, "parameters": None}, trustworthy=False)
    assert "Parameters beside it" not in page_of(alone)[1].texts["h3"]


def test_nothing_of_the_data_is_markup(tmp_path: Path) -> None:
    h = made.HOSTILE
    unlisted = {"channel": h, "where": None, "when_s": None, "excess_share": 0.1, "effect_file": h}
    said = {"accepted": ["lamp", h], "undecided": [h], "unfelt": [h], "doubts": [h], "unlisted": unlisted, "trustworthy": False}
    folder = tmp_path / "plain"
    made.whole_run(folder, **said)
    phases = [{"label": h, "t0": 0.0, "t1": 90.0}]
    made.write(folder, made.interpolated(verdict=h, phases=phases, repairs=[h], remarks=[h]), made.calibrated(verdict=h))
    text, page, views = page_of(folder)
    assert page.wrong == [] and len([tag for tag, _ in page.elements if tag == "script"]) == 2
    assert not [tag for tag, a in page.elements if tag == "img" or any(name.startswith("on") for name in a)]
    assert h in page.texts["li"] and any(h in text for text in page.texts["h1"])
    assert not set("<>&") & set(re.search(r'id="views">(.*?)</script>', text, re.DOTALL)[1])  # type: ignore[index]
    assert views["tests"][0]["phases"][0]["label"] == h and views["cameras"][0]["says"] == h
    _, page, views = page_of(made.records_run(tmp_path / "records", name=h))
    assert views["records"][0]["name"] == h and len([tag for tag, _ in page.elements if tag == "script"]) == 2


def test_records_have_curves_and_residuals(tmp_path: Path) -> None:
    text, page, views = page_of(made.records_run(tmp_path))
    first, second = views["records"]
    assert (first["name"], second["name"]) == ("pull 1", "pull 2") and not views["tests"] and "maps" not in page.values("id")
    assert first["residuals"][0]["before"][0] == -5.0 and second["residuals"][0]["before"][-1] == 5.0
    assert first["residuals"][0]["sigma"][0] == 2.0
    assert first["curves"]["measured_stress"][0] == 1.0 and page.wrong == []
    assert "Every record was followed by a material point" in text


def test_several_experiments_are_on_one_page(tmp_path: Path) -> None:
    for name in ("one", "two"):
        made.write(tmp_path / name, made.interpolated(), made.verified(), made.calibrated())
    made.write(tmp_path, made.identified("identify-elastic", "E", "nu"), made.identified("identify-plastic", "M_y0", "F"), made.verified())
    text, _, views = page_of(tmp_path)
    assert [t["name"] for t in views["tests"]] == [c["name"] for c in views["cameras"]] == ["one", "two"]
    assert "2 experiments were evaluated together: one, two." in text


def test_rows_of_several_experiments_get_their_own_times_back(tmp_path: Path) -> None:
    """In a joint fit the rows of one experiment follow those of the other in time."""
    loop, parts = made.looped(), []
    late = float(made.TIME[-1]) + 1.0
    for number in (0, 1):
        own = {key.removeprefix("residual/"): d.value for key, d in loop.datasets.items() if key.startswith("residual/")}
        parts.append({**own, "channel": own["channel"] + 2 * number, "time": own["time"] + late * number, "value": own["value"] + number})
    data = {f"residual/{key}": replace(loop.datasets[f"residual/{key}"], value=np.concatenate([p[key] for p in parts])) for key in parts[0]}
    names = np.array([f"{c}@{test}" for test in ("one", "two") for c in ("du", "dtheta")])
    data["rms/channel"] = replace(loop.datasets["rms/channel"], value=names)
    for name in ("one", "two"):
        made.write(tmp_path / name, made.interpolated(), made.verified())
    made.write(tmp_path, made.verified(), replace(loop, datasets=data))
    found = {(p.test, p.channel): p for p in pairs(read_run(tmp_path)) if p.component == 0}
    assert set(found) == {(test, c) for test in ("one", "two") for c in ("du", "dtheta")}
    for pair in found.values():
        np.testing.assert_allclose(pair.before.time, made.TIME)
    first, second = (found[test, "dtheta"].after for test in ("one", "two"))
    assert first is not None and second is not None
    assert np.nanmax(np.abs(second.value - first.value - 1.0)) < 1e-12


def test_a_necking_test_has_its_own_sentence(tmp_path: Path) -> None:
    record = RecordContent("necking", {}, {}, {}, made.parameters("n"), {"verdict": "n 0.2 +- 0.01"})
    content = write_report(made.write(tmp_path, record)).content
    assert content.verdict.sentence == "Necking test: n 0.2 +- 0.01." and content.verdict.trustworthy
    assert [p.name for p in content.parameters] == ["n"] and not [s for s in content.stages if s.state == "missing"]


def test_a_run_that_stopped_shows_what_there_is(tmp_path: Path) -> None:
    text, page, views = page_of(made.write(tmp_path, made.interpolated()))
    assert "The run stopped after interpolate" in "".join(page.texts["h1"]) and views["tests"][0]["fields"]["theta"]["predicted"] is None
    missing = " ".join(page.texts["li"])
    assert all(f"`thermofit {stage} STUDY.yaml`" in missing for stage in ("identify-elastic", "identify-thermal", "verify", "close-loop"))
    assert page.wrong == [] and "Which causes were asked?" not in text
    made.write(tmp_path, made.identified("identify-elastic", "E", "nu"))
    (tmp_path / "identify-plastic.h5").write_bytes(b"\x89HDF\r\n\x1a\n cut off")
    content = write_report(tmp_path, failure="numerics: no step").content
    states = {s.stage: s.state for s in content.stages}
    assert (states["identify-plastic"], states["identify-elastic"], states["verify"]) == ("unreadable", "done", "missing")
    assert content.verdict.open[0] == "the last command ended with an error: numerics: no step" and not content.verdict.trustworthy
    assert {p.name for p in content.parameters} == {"E", "nu"}


def test_large_fields_are_thinned_and_it_says_so(run: Path) -> None:
    whole, thin = views_of(read_run(run), None), views_of(read_run(run), None, budget=3000)
    assert whole["thinned"] == "" and "th time is drawn" in thin["thinned"]
    assert len(thin["tests"][0]["maps"][0]["time"]) < len(whole["tests"][0]["maps"][0]["time"])
    assert len(thin["tests"][0]["fields"]["u"]["stress"]) == len(thin["tests"][0]["fields"]["u"]["time"])
    assert BUDGET * 2 * 4 / 3 < 13e6, "so much of 15 MB may be values"


def test_rows_become_a_field_in_any_order() -> None:
    rng = np.random.default_rng(0)
    value = rng.normal(size=(4, 5, 2))
    value[2, 3] = np.nan
    xy = rng.normal(size=(5, 2)).round(3)
    place = np.argwhere(np.isfinite(value))
    field = field_of_rows(place[:, 0] * 1.5, xy[place[:, 1]], value[tuple(place.T)])
    at = [int(np.flatnonzero((field.xy == p).all(axis=1))[0]) for p in xy]
    np.testing.assert_array_equal(field.value[:, at], value)


def test_raster_shows_the_nearest_point() -> None:
    found = raster(made.XY)
    index = np.frombuffer(base64.b64decode(found["data"]), dtype="<i2").reshape(found["h"], found["w"])
    top, right = index[3, -3], int(np.argmax(made.XY @ [1.0, 1.0]))
    assert top == right and set(np.unique(index)) >= set(range(len(made.XY)))


def test_packed_values_keep_four_digits_of_their_range() -> None:
    value = np.array([[np.nan, -3.0, 0.5], [7.0, np.inf, 2.0]])
    back = unpacked(packed(value))
    assert np.isnan(back[0, 0]) and np.isnan(back[1, 1])
    np.testing.assert_allclose(back[np.isfinite(back)], [-3.0, 0.5, 7.0, 2.0], atol=10.0 / 65534)
    assert unpacked(packed(np.full(3, 2.5))).tolist() == [2.5] * 3 and np.isnan(unpacked(packed(np.full(2, np.nan)))).all()


def test_methods_cite_what_the_references_hold(run: Path) -> None:
    folder = read_run(run)
    text = methods_text(folder)
    entries = references(text, folder)
    cited, held = set(re.findall(r"@(\w+)", text)), set(re.findall(r"^@\w+\{(\w+),", entries, re.MULTILINE))
    assert cited == held and "effect_lamp" in cited and "hill1948" in cited
    assert entries.count("{") == entries.count("}")
    assert "54 points" in text and "identify-plastic fitted F, M_y0" in text
    short = methods_text(read_run(made.write(run.parent / "short", made.interpolated())))
    assert "fitted" not in short and "An effect was added" not in short


def test_schema_on_disk_is_that_of_the_report() -> None:
    assert json.loads(SCHEMA.read_text(encoding="utf-8")) == report_schema(), "run `make schema`"


def call(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    return result.exit_code, result.output


def test_the_command_takes_a_run_folder(run: Path, tmp_path: Path) -> None:
    code, text = call("report", run, "--json")
    assert code == 0 and json.loads(text)["pages"]["html"] == str(run / "report.html")
    code, text = call("report", run)
    assert code == 0 and "The model lacks lamp" in text
    code, text = call("report", run, "--set", "mesh=coarse")
    assert code == 2 and "or name a study" in text
    code, text = call("report", tmp_path)
    assert code == 2 and "holds no artefact" in text
    code, _ = call("report", made.records_run(tmp_path / "records"))
    assert code == 5, "the model does not explain the records"


def test_a_file_in_the_way_is_one_sentence(tmp_path: Path) -> None:
    made.write(tmp_path, made.interpolated())
    (tmp_path / "report.html").mkdir()
    with pytest.raises(StudyError, match="expected a writable folder"):
        write_report(tmp_path)
