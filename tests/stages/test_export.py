"""export: fields that ParaView opens, tables, covariances, and material cards that draw the bar as the identified law does."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
import verify_fixtures as made
import yaml
from meshio.xdmf import TimeSeriesReader
from published_surfaces import AA2090_T3
from small_bodies import bar_mesh
from typer.testing import CliRunner

from thermofit.body.body import tension_body
from thermofit.body.mesh.mesh import Mesh
from thermofit.body.solve.march import History, Loading, MarchSettings, march
from thermofit.cli.app import app
from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.core.slots import Slots
from thermofit.effects.catalogue import effect
from thermofit.export.card import Card, Visited, card_of, flow_curve, heat_share, visited_by
from thermofit.export.card_texts import CARDS, ratios
from thermofit.export.results import Finished, finished
from thermofit.export.tables import covariances, csv_text, latex_text, tables_of
from thermofit.law.page import law_of, surface_gradient
from thermofit.law.surface.catalogue import NUMBERS
from thermofit.records.artefact import Dataset, Record, RecordContent, of_parameters, open_record, write_record
from thermofit.records.staging import artefact_path
from thermofit.stages import export, verify
from thermofit.study.study import Study, load_study

LENGTH, WIDTH, THICKNESS, DRAWN = 50.0, 12.5, 0.6, 0.1
AREA = 4.0 * WIDTH * THICKNESS
"""Of the whole bar, of which the mesh is a quarter; mm^2."""
COVARIANCE = np.array([[4.0, 1.0, 0.1, 0.0], [1.0, 9.0, 0.0, 0.2], [0.1, 0.0, 0.5, 0.0], [0.0, 0.2, 0.0, 1e-4]])


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """A verified run; its plastic stage has a covariance."""
    study = made.study_in(tmp_path_factory.mktemp("export"), experiment=None, simulate={"truth": made.VALUES})
    units = ("MPa", "MPa", "1", "1")
    matrix = of_parameters(COVARIANCE, ("parameter", "parameter"), units)
    stages = [made.identified(name, made.TRUTH, **({"covariance": matrix} if "plastic" in name else {})) for name in made.FREE]
    made.write_all(study, made.interpolated(made.coupled_run()), *stages)
    verify.run(study)
    return study


@pytest.fixture(scope="module")
def run(study: Study) -> Finished:
    return finished(study.run_dir, load_study)


@pytest.fixture(scope="module")
def card(run: Finished) -> Card:
    return card_of("alloy", run.parameters, run.verified)


@pytest.fixture(scope="module")
def written(study: Study) -> dict[str, Any]:
    return export.run(study.run_dir, load_study)


def drawn_mesh() -> Mesh:
    return bar_mesh((1, 4, 1), (WIDTH, LENGTH, THICKNESS))


@pytest.fixture(scope="module")
def drawn(run: Finished) -> History:
    """The bar drawn by DRAWN by the identified law."""
    times = np.linspace(0.0, 80.0, 41)
    parameters = run.parameters.replace(theta_air=run.parameters["theta_ref"], theta_clamp=run.parameters["theta_ref"])
    loading = Loading(np.array([0.0, 80.0]), np.array([0.0, DRAWN * LENGTH]), "displacement")
    return march(tension_body(drawn_mesh(), control="displacement"), parameters, loading, times, MarchSettings())


# Fields


def frames(written: dict[str, Any], name: str) -> Iterator[tuple[float, meshio.Mesh]]:
    listed = next(Path(path) for path in written["files"]["fields"] if Path(path).name == f"{name}.pvd")
    for entry in ElementTree.parse(listed).getroot().iter("DataSet"):
        yield float(entry.attrib["timestep"]), meshio.read(listed.parent / entry.attrib["file"])


def test_fields_are_those_of_the_identified_run(written: dict[str, Any]) -> None:
    history, shown = made.coupled_run(), list(frames(written, "model"))
    assert [t for t, _ in shown] == pytest.approx(made.TIME)
    for n, (_, mesh) in enumerate(shown):
        assert mesh.point_data["u"] == pytest.approx(history.u[n], abs=1e-6)
        assert mesh.point_data["theta"] == pytest.approx(history.theta[n], abs=1e-4)
    last, peak = shown[-1][1], shown[int(np.argmax(made.FORCE))][1]
    assert np.max(peak.cell_data["Lambda"][0]) == pytest.approx(history.largest_multiplier[int(np.argmax(made.FORCE))], rel=0.1)
    assert peak.cells[0].type == "hexahedron"
    assert np.linalg.det(peak.cell_data["F"][0].reshape(-1, 3, 3)) == pytest.approx(np.ones(24), abs=2e-2)
    volume = np.prod(np.ptp(last.points[last.cells[0].data], axis=1), axis=1)  # of bricks; those of the shoulders hardly flow
    assert 4.0 * volume @ last.cell_data["dissipation"][0] == pytest.approx(history.total("dissipated"), rel=0.05)


def test_stress_carries_the_force(written: dict[str, Any]) -> None:
    """Across the middle of the bar the load over the current area is the axial stress, and nothing else acts there."""
    n = int(np.argmax(made.FORCE))
    _, mesh = list(frames(written, "model"))[n]
    centre = mesh.points[mesh.cells[0].data].mean(axis=1)
    middle = np.abs(centre[:, 1]) < 15.0
    stress, f = (mesh.cell_data[key][0].reshape(-1, 3, 3)[middle] for key in ("stress", "F"))
    area = made.SPECIMEN.gauge_width * made.SPECIMEN.thickness * f[:, 0, 0] * f[:, 2, 2]
    assert np.mean(stress[:, 1, 1] * area) == pytest.approx(made.FORCE[n], rel=5e-3)
    assert np.max(np.abs(stress[:, 2, 2])) < 0.02 * np.mean(stress[:, 1, 1])


def test_residuals_over_time_are_those_of_verify(written: dict[str, Any], study: Study) -> None:
    record = open_record(artefact_path(study.run_dir, "verify"))
    for name, n_c in (("u", 2), ("theta", 1)):
        shown = list(frames(written, f"measured-{name}"))
        assert [t for t, _ in shown] == pytest.approx(record[f"{name}/time"].value)
        for n, (_, mesh) in enumerate(shown):
            residual = mesh.point_data["residual"].reshape(len(mesh.points), -1)[:, :n_c]
            np.testing.assert_allclose(residual, record[f"residual/d{name}"].value[n])


@pytest.mark.as_written
def test_paraview_library_opens_the_series(written: dict[str, Any]) -> None:
    pyvista = pytest.importorskip("pyvista", reason="the optional package pyvista (thermofit[paraview]) is not installed")
    path = next(p for p in written["files"]["fields"] if p.endswith("model.pvd"))
    reader = pyvista.get_reader(path)
    assert reader.time_values == pytest.approx(made.TIME)
    reader.set_active_time_value(reader.time_values[-1])
    block = reader.read()[0]
    assert {"u", "theta"} <= set(block.point_data.keys())
    assert {"Lambda", "alpha", "F", "stress", "dissipation"} <= set(block.cell_data.keys())
    history = made.coupled_run()
    assert block.point_data["u"].max() == pytest.approx(history.u[-1].max())
    assert block.bounds[2:4] == pytest.approx((block.points[:, 1].min(), block.points[:, 1].max()))


@pytest.mark.parametrize("name", ["model", "measured-u", "measured-theta"])
def test_the_xdmf_file_holds_the_same_series(written: dict[str, Any], name: str) -> None:
    """One file of text and one of data instead of one VTU a time; times, points, cells and values are the same."""
    path = next(Path(path) for path in written["files"]["fields"] if Path(path).name == f"{name}.xdmf")
    with TimeSeriesReader(path) as reader:
        points, cells = reader.read_points_cells()
        shown = list(frames(written, name))
        assert reader.num_steps == len(shown)
        for n, (time, mesh) in enumerate(shown):
            t, of_points, of_cells = reader.read_data(n)
            assert t == pytest.approx(time) and set(of_points) == set(mesh.point_data) and set(of_cells) == set(mesh.cell_data)
            for key, value in mesh.point_data.items():
                np.testing.assert_allclose(of_points[key], value)
            for key, values in mesh.cell_data.items():
                np.testing.assert_allclose(of_cells[key][0], values[0])
    np.testing.assert_allclose(points, mesh.points)
    np.testing.assert_array_equal(cells[0].data, mesh.cells[0].data)


# Tables and JSON


def rows_of(path: Path) -> list[list[str]]:
    return list(csv.reader(path.read_text(encoding="utf-8").splitlines()))


def test_covariance_is_in_csv_and_json_to_all_digits(written: dict[str, Any], run: Finished) -> None:
    folder = Path(written["folder"])
    rows = rows_of(folder / "tables" / "identify-plastic-covariance.csv")
    assert rows[0] == ["parameter", "unit", "M_y0 [MPa]", "M_yinf [MPa]", "H_exp", "F"]
    assert np.array([row[2:] for row in rows[1:]], dtype=float).tolist() == COVARIANCE.tolist()
    told = json.loads((folder / "results.json").read_text())["stages"]["identify-plastic"]
    assert told["covariance"]["matrix"] == COVARIANCE.tolist()
    assert told["covariance"]["parameters"] == ["M_y0", "M_yinf", "H_exp", "F"]
    assert told["parameters"]["F"]["value"] == run.parameters["F"]
    assert [c.stage for c in covariances(run.records)] == ["identify-plastic"]


def test_tables_hold_values_as_stored(written: dict[str, Any], run: Finished) -> None:
    rows = rows_of(Path(written["folder"]) / "tables" / "verify-parameters.csv")
    value = {row[0]: float(row[rows[0].index("value")]) for row in rows[1:]}
    assert value == {name: p.value for name, p in run.verified.parameters.items() if p.free}
    curve = rows_of(Path(written["folder"]) / "tables" / "verify-curves-stress_stretch-step.csv")
    assert "step_stress [MPa]" in curve[0] and len(curve) == len(made.TIME) + 1


def test_printed_tables_are_whole(written: dict[str, Any]) -> None:
    text = (Path(written["folder"]) / "tables.tex").read_text()
    assert text.count("\\begin{tabular}") == text.count("\\end{tabular}") > 3
    assert r"M\_y0" in text and not re.search(r"(?<!\\)_(?!\{)", text.replace("\\label{", "").replace("booktabs", ""))
    for block in re.findall(r"\\begin\{tabular\}\{([lr]+)\}\n\\toprule\n(.*?)\\bottomrule", text, flags=re.S):
        for line in block[1].splitlines():
            assert line == "\\midrule" or len(re.split(r"(?<!\\)&", line)) == len(block[0]), line
    assert "| M_y0 | MPa |" in (Path(written["folder"]) / "tables.md").read_text()


def test_what_is_missing_is_empty_in_a_table(run: Finished) -> None:
    table = next(t for t in tables_of(run.records) if t.name == "verify-channels")
    assert "nan" not in csv_text(table).lower() and "None" not in latex_text([table])


# Cards: their text alone against the identified law


def numbers_below(text: str, keyword: str) -> np.ndarray:
    """Lines of numbers below a keyword of an Abaqus or CalculiX deck."""
    rows, inside = [], False
    for line in text.splitlines():
        if line.startswith("*"):
            inside = line.split(",")[0] == keyword
        elif inside:
            rows.append([float(cell) for cell in line.split(",") if cell.strip()])
    return np.array(rows)


def force_by_card(text: str, elongation: np.ndarray) -> np.ndarray:
    """Force N on the bar at given elongations (shares of its length), from the text of a card alone: uniaxial stress, Hooke's law and the
    table in logarithmic strain, flow without change of volume."""
    young, poisson = numbers_below(text, "*ELASTIC")[0]
    stress, plastic = numbers_below(text, "*PLASTIC").T
    true = np.interp(np.log1p(elongation), plastic + stress / young, stress, left=np.nan)
    true = np.where(np.isnan(true), young * np.log1p(elongation), true)
    return np.asarray(true * AREA * np.exp(-np.log1p(elongation) + (1.0 - 2.0 * poisson) * true / young))


@pytest.mark.parametrize("name", ["calculix", "abaqus"])
def test_card_alone_draws_the_bar(card: Card, drawn: History, name: str) -> None:
    """Within 1 % of force over the whole drawing, elastic beginning and yield included; the law is one with Hill's F = 0.35."""
    force = force_by_card(CARDS[name][1](card, None), drawn.u_top / LENGTH)
    assert force[1:] == pytest.approx(drawn.force[1:], rel=1e-2)
    assert np.max(np.abs(force[5:] / drawn.force[5:] - 1.0)) < 2e-3


def test_calculix_draws_the_bar(card: Card, drawn: History, tmp_path: Path) -> None:
    """The card as CalculiX reads it, on the same mesh."""
    if shutil.which("ccx") is None:
        pytest.skip("no program `ccx` was found (Debian: apt install calculix-ccx); the card was checked by its text alone")
    mesh = drawn_mesh()
    lines = ["*NODE, NSET=ALL", *(f"{n}, {x:.9g}, {y:.9g}, {z:.9g}" for n, (x, y, z) in enumerate(mesh.nodes, 1))]
    lines += ["*ELEMENT, TYPE=C3D8, ELSET=BODY", *(", ".join(map(str, (n, *(h + 1)))) for n, h in enumerate(mesh.hexes, 1))]
    for key, nodes in mesh.node_sets.items():
        lines += [f"*NSET, NSET={key.upper()}", *(f"{node + 1}," for node in nodes)]
    theta = card.parameters["theta_ref"]
    lines += [CARDS["calculix"][1](card, 2.7e-9).rstrip(), f"*SOLID SECTION, ELSET=BODY, MATERIAL={card.name.upper()}"]
    lines += ["*INITIAL CONDITIONS, TYPE=TEMPERATURE", f"ALL, {theta}", "*STEP, NLGEOM, INC=500", "*STATIC", "0.02, 1., 1e-6, 0.02"]
    lines += ["*BOUNDARY", "X0, 1, 1", "BOTTOM, 2, 2", "Z0, 3, 3", f"TOP, 2, 2, {DRAWN * LENGTH}"]
    lines += ["*NODE PRINT, NSET=TOP, TOTALS=ONLY", "RF", "*END STEP", ""]
    (tmp_path / "bar.inp").write_text("\n".join(lines), encoding="ascii")
    done = subprocess.run(["ccx", "bar"], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert "*ERROR" not in done.stdout, done.stdout[-2000:]
    found = re.findall(r"total force.*time\s+(\S+)\s+(\S+)\s+(\S+)\s+(\S+)", (tmp_path / "bar.dat").read_text())
    assert len(found) >= 50
    share, force = np.array([float(t) for t, *_ in found]), 4.0 * np.array([float(row[2]) for row in found])
    assert np.interp(share[1:], drawn.u_top / (DRAWN * LENGTH), drawn.force) == pytest.approx(force[1:], rel=1e-2)


def test_ratios_are_yield_stresses_of_the_surface(card: Card) -> None:
    """Abaqus's ratios: yield under one stress component over that along axis 2, of shear times sqrt(3); by the quadratic form (4.19)."""
    p = card.parameters

    def yields_at(s: list[list[float]]) -> float:
        a = np.array(s)
        form = p["F"] * (a[0, 0] - a[1, 1]) ** 2 + p["G"] * (a[2, 2] - a[0, 0]) ** 2 + p["H"] * (a[1, 1] - a[2, 2]) ** 2
        form += 2.0 * (p["L"] * a[0, 1] ** 2 + p["M"] * a[1, 2] ** 2 + p["N"] * a[0, 2] ** 2)
        return float(1.0 / np.sqrt(form))

    along = [[[float(i == j == k) for i in range(3)] for j in range(3)] for k in range(3)]
    shear = [[[float({i, j} == pair) for i in range(3)] for j in range(3)] for pair in ({0, 1}, {0, 2}, {1, 2})]
    reference = yields_at(along[1])
    expected = [yields_at(s) / reference for s in along] + [np.sqrt(3.0) * yields_at(s) / reference for s in shear]
    assert ratios(card) == pytest.approx(expected)
    numbers = numbers_below(CARDS["abaqus"][1](card, None), "*POTENTIAL")
    assert numbers[0] == pytest.approx(expected, rel=1e-6)


def test_hill_constants_of_mfront_act_where_they_should(card: Card) -> None:
    text = CARDS["mfront"][1](card, None)
    found = {key: float(value) for key, value in re.findall(r"([FGHLMN]) : ([0-9.e+-]+)", text.split("criterion")[1].split("}")[0])}
    p, size = card.parameters, card.parameters["F"] + card.parameters["H"]
    ours = {"F": "F", "G": "H", "H": "G", "L": "L", "M": "N", "N": "M"}
    assert found == pytest.approx({theirs: p[mine] / size for theirs, mine in ours.items()}, rel=1e-6)
    assert f"thermal_expansion : {p['alpha_exp']:.8g}, thermal_expansion_reference_temperature : {p['theta_ref']:.8g}" in text
    assert text.count("{") == text.count("}")


def test_ls_dyna_fields_lie_in_their_columns(card: Card) -> None:
    lines = CARDS["ls-dyna"][1](card, 7.8e-9).splitlines()
    data = lines[lines.index("*MAT_PIECEWISE_LINEAR_PLASTICITY_TITLE") + 3]
    fields = [data[10 * k : 10 * k + 10] for k in range(8)]
    assert float(fields[1]) == 7.8e-9 and float(fields[2]) == pytest.approx(card.parameters["E"], rel=1e-4)
    rows = lines[lines.index("*DEFINE_CURVE") + 4 : lines.index("*MAT_THERMAL_ISOTROPIC")]
    curve = np.array([[float(row[:20]), float(row[20:])] for row in rows])
    assert curve[:, 1] == pytest.approx(card.reference.stress, rel=1e-7)
    assert float(lines[lines.index("*MAT_THERMAL_ISOTROPIC") + 4][:10]) == pytest.approx(card.capacity / 7.8e-9, rel=1e-3)


def test_rates_and_temperatures_are_tabulated_where_the_law_has_them(run: Finished) -> None:
    plain = card_of("alloy", run.parameters, run.verified)
    assert len(plain.curves) == 1
    rated = card_of("alloy", with_effect(run.parameters, "rate_logarithmic", 0.02), run.verified)
    assert rated.of_rates and not rated.of_temperatures
    text = CARDS["abaqus"][1](rated, None)
    assert text.count("*PLASTIC, RATE=") == 5 and "rate_logarithmic is in this card" in text
    dyna = CARDS["ls-dyna"][1](rated, None)
    assert dyna.count("*DEFINE_CURVE") == 5 and "*DEFINE_TABLE_2D" in dyna
    assert "this card holds one curve" in CARDS["calculix"][1](rated, None)
    stress = {c.rate: c.stress[0] for c in rated.curves}
    assert np.all(np.diff([stress[rate] for rate in sorted(stress)]) > 0.0)
    soft = card_of("alloy", with_effect(run.parameters, "thermal_softening", 1e-2), run.verified)
    assert soft.of_temperatures and numbers_below(CARDS["calculix"][1](soft, None), "*PLASTIC").shape[1] == 3


def test_a_modulus_that_changes_with_temperature_is_tabulated(run: Finished) -> None:
    """E over the temperatures of the test where a programme takes it, else E at the temperature of its curve, which is said."""
    warm = card_of("alloy", with_effect(run.parameters, "modulus_by_temperature", 2e-3), run.verified)
    low, high = warm.visited.temperature
    for name in ("abaqus", "calculix"):
        table = numbers_below(CARDS[name][1](warm, None), "*ELASTIC")
        assert table[:, 2] == pytest.approx(np.linspace(low, high, 5), abs=1e-3) and np.all(table[:, 1] == run.parameters["nu"])
        assert table[:, 0] == pytest.approx(run.parameters["E"] * (1.0 - 2e-3 * (table[:, 2] - 293.15)), rel=1e-4)
    text = CARDS["abaqus"][1](warm, None)
    assert "modulus_by_temperature is in this card" in text
    middle = run.parameters["E"] * (1.0 - 2e-3 * (warm.reference.theta - 293.15))
    assert warm.young == pytest.approx(middle, rel=1e-4) and abs(middle / run.parameters["E"] - 1.0) > 1e-3
    for name, shown in (("ls-dyna", f"{warm.young:>10.4g}"), ("mfront", f"young_modulus : {warm.young:.8g},")):
        assert shown in CARDS[name][1](warm, None) and "this card holds E at" in CARDS[name][1](warm, None)
    assert f"E_MPa: {warm.moduli[0][1]}" in CARDS["yaml"][1](warm, None)
    plain = card_of("alloy", run.parameters, run.verified)
    assert plain.moduli == ((plain.visited.middle_temperature, run.parameters["E"]),) and plain.young == run.parameters["E"]
    assert "this card holds E at" not in CARDS["mfront"][1](plain, None)


def with_effect(parameters: Parameters, name: str, amplitude: float) -> Parameters:
    return parameters.replace(**{effect(name).amplitude.name: amplitude})


def test_an_effect_that_no_card_can_hold_is_told(run: Finished) -> None:
    told = card_of("alloy", with_effect(run.parameters, "backstress_first", 500.0), run.verified)
    assert "backstress_first IS NOT IN THIS CARD" in CARDS["yaml"][1](told, None)


def test_a_surface_that_is_not_quadratic(run: Finished) -> None:
    """MFront and YAML hold it, scaled to the table's stress along axis 2; the others take von Mises and name it."""
    config = {**run.verified.config, "yield_surface": "yld2004"}
    values = {**AA2090_T3, "yld2004.c1_44": 0.9}
    card = card_of("alloy", run.parameters.replace(F=0.5, **values), replace(run.verified, config=config))
    assert card.transformed is not None and not card.isotropic
    law = law_of(run.parameters.replace(**values), Slots(1, "yld2004"))
    scaled = law._replace(**dict(zip(NUMBERS, card.transformed, strict=True)))
    assert surface_gradient(0.0, 1.0, 0.0, scaled)[1] == pytest.approx(1.0, rel=1e-12)
    for name in ("abaqus", "calculix", "ls-dyna"):
        text = CARDS[name][1](card, None)
        assert "this card yields by von Mises: right along axis 2 alone; the identified surface is yld2004" in text
        assert "*POTENTIAL" not in text
    size = card.transformed[1] / law.surface_1_c12
    text, numbers = (
        CARDS["mfront"][1](card, None),
        [values[f"yld2004.c1_{at}"] for at in ("21", "12", "23", "32", "13", "31", "66", "44", "55")],
    )
    assert 'criterion : "Barlat" {a : 8, l1 : {' + ", ".join(f"{size * c:.8g}" for c in numbers) in text
    kept = yaml.safe_load(CARDS["yaml"][1](card, None))["yield_surface"]
    assert kept["name"] == "yld2004" and kept["c2"]["66"] == pytest.approx(size * 1.40462) and kept["c1"]["55"] == pytest.approx(size * 0.9)


def test_range_is_what_the_test_visited(card: Card, run: Finished) -> None:
    record: Record = run.verified
    largest = float(np.log(record["curves/stress_stretch/step_stretch"].value.max()))
    assert 0.8 * largest < card.visited.strain < largest
    theta = record["theta/value"].value
    assert card.visited.temperature[0] <= np.nanmin(theta) and card.visited.temperature[1] >= np.nanmax(theta)
    assert card.visited.rate[0] < card.visited.rate[1] < 1e-2
    told = yaml.safe_load(CARDS["yaml"][1](card, None))
    assert told["range_of_validity"]["plastic_strain"][1] == pytest.approx(card.visited.strain)
    assert told["effects"] == [] and told["yield_curves"][0]["yield_stress_MPa"] == pytest.approx(card.reference.stress)


def test_range_of_several_tests_is_that_of_all(card: Card, run: Finished, tmp_path: Path) -> None:
    """The joined record of several experiments has no curves of its own: those of each count. Of coupons the flow of all cycles does."""
    joined = write_record(tmp_path / "verify.h5", RecordContent("verify", run.verified.config, {}, {}, run.verified.parameters))
    assert "nothing is known" in visited_by((joined,), run.parameters).source
    time = np.array([0.0, 1.0, 2.0])
    columns = {"time": (time, "s"), "accumulated": (0.1 * time, "1"), "theta": (300.0 + 50.0 * time, "K")}
    curves = {f"curves/0/{key}": Dataset(value, unit, ("sample",)) for key, (value, unit) in columns.items()}
    (tmp_path / "b").mkdir()
    coupon = write_record(tmp_path / "b" / "verify.h5", RecordContent("verify", {}, {}, curves))
    both = card_of("alloy", run.parameters, joined, (run.verified, coupon)).visited
    assert both.strain == pytest.approx(0.2 * np.sqrt(0.85)) and both.temperature[1] == 400.0
    assert both.temperature[0] == card.visited.temperature[0] and "1 records" in both.source
    assert finished(tmp_path, load_study).tests[0].path == coupon.path


def test_share_of_heat_without_hardening_is_beta(run: Finished) -> None:
    """Dissipation beta M_y0 over work M_y0 where nothing hardens."""
    visited = Visited(0.1, (1e-3, 1e-3), (297.0, 297.0), "")
    flat = run.parameters.replace(M_yinf=run.parameters["M_y0"])
    assert heat_share(flat, "voce", visited) == pytest.approx(run.parameters["beta"], rel=1e-9)
    assert flow_curve(flat, "voce", np.array([0.0, 0.1]), 1e-3, 297.0).stress == pytest.approx(129.0 / np.sqrt(0.85))


# The command


def call(*arguments: Any) -> Any:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_command_writes_the_kinds_that_are_named(study: Study, tmp_path: Path) -> None:
    done = call("export", study.run_dir, "cards", "--to", tmp_path / "cards-here", "--density", 2700, "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert list(result["files"]) == ["cards"] and len(result["files"]["cards"]) == len(CARDS)
    assert numbers_below((tmp_path / "cards-here/cards/calculix.inp").read_text(), "*DENSITY")[0, 0] == pytest.approx(2.7e-9)
    assert "results" in call("export", study.source, "results").stdout


@pytest.mark.parametrize(
    ("arguments", "told"),
    [(("cardz",), "cards"), (("cards", "--density", "-1"), "above zero")],
)
def test_wrong_requests_are_told(study: Study, arguments: tuple[str, ...], told: str) -> None:
    done = call("export", study.run_dir, *arguments)
    assert done.exit_code == 2 and told in done.stderr


def test_a_run_without_verification_has_tables_but_no_card(study: Study, tmp_path: Path) -> None:
    stored = made.identified("identify-elastic", made.TRUTH)
    write_record(tmp_path / "identify-elastic.h5", stored)
    result = export.run(tmp_path, load_study)
    assert "tables" in result["files"] and "verify" in result["left_out"]["cards"]
    with pytest.raises(StudyError, match=r"verify\.h5"):
        export.run(tmp_path, load_study, ["cards"])
    with pytest.raises(StudyError, match="no artefact"):
        export.run(tmp_path / "..", load_study)
    with pytest.raises(StudyError, match="no folder"):
        export.run(tmp_path / "nothing", load_study)
