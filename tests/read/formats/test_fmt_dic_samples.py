"""Exports of other people's projects are read with the right points, units and missing counts."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from thermofit.read.formats.clock import Rules
from thermofit.read.formats.contents import ChannelRecord, DicStage, ScalarField
from thermofit.read.formats.registry import read_native
from thermofit.read.formats.sequence import read_dic_files

DATA = Path(os.environ.get("THERMOFIT_DATA", "/nonexistent")) / "real"
SAMPLES = DATA / "native-format-samples"
pytestmark = pytest.mark.skipif(not SAMPLES.is_dir(), reason="needs THERMOFIT_DATA with real/native-format-samples")


@pytest.mark.parametrize(("number", "points"), [(1, 4090), (151, 4064)])
def test_gom_points(number: int, points: int) -> None:
    stage = read_native(SAMPLES / "gom-points" / f"VHPS_140_140_3_{number:04d}.csv")
    assert isinstance(stage, DicStage) and stage.deformed is not None
    assert (len(stage.point_id), stage.stage, stage.length_unit, stage.traits.missing) == (points, number, "mm", 0)
    assert stage.displacement is None


def test_gom_points_as_a_series() -> None:
    field, remarks = read_dic_files(SAMPLES / "gom-points" / "*.csv", Rules(rate=2.0))
    assert field.displacement.shape == (2, 4090, 3)
    assert field.time.tolist() == [0.0, 75.0]
    assert np.isnan(field.displacement[1, :, 0]).sum() == 26
    assert "26 of 8180 displacements missing, 26 of 4090 points concerned" in remarks
    assert (field.displacement[0] == 0.0).all()


def test_matchid_table() -> None:
    stage = read_native(SAMPLES / "matchid-table" / "Img_Simu_0001.bmp 1.csv")
    assert isinstance(stage, DicStage) and stage.reference is not None and stage.displacement is not None
    assert (len(stage.point_id), stage.stage, stage.length_unit, stage.traits.missing) == (9310, 1, "mm", 0)
    np.testing.assert_allclose(stage.reference[0, :2], [7.425, 10.775])
    np.testing.assert_allclose(stage.displacement[0, 1], -0.1763503367)
    assert set(stage.strain) == {"exx", "eyy", "exy"}


@pytest.mark.parametrize(
    ("file", "shape", "missing", "number"),
    [
        ("test_data_g1/patD107_0.tif_U[mm].csv", (68, 78), 0, "107"),
        ("test_data_g1/patD110_0.tif_U[mm].csv", (68, 78), 0, "110"),
        ("test_data_g2/mesh_plane_1.csv_0.tiff_V[mm].csv", (61, 52), 2883, "1"),
        ("test_data_g2/mesh_plane_4.csv_0.tiff_V[mm].csv", (58, 47), 2663, "4"),
    ],
)
def test_matchid_matrix(file: str, shape: tuple[int, int], missing: int, number: str) -> None:
    field = read_native(SAMPLES / "matchid-matrix" / file)
    assert isinstance(field, ScalarField)
    assert (field.values.shape, field.traits.missing, field.unit, field.traits.decimal) == (shape, missing, "mm", ",")
    assert field.traits.header["stage"] == number
    text = (SAMPLES / "matchid-matrix" / file).read_text(encoding="latin-1")
    assert text.count("Non un numero reale") == missing
    assert np.isfinite(field.values).sum() + missing == field.values.size


def test_aramis_sections() -> None:
    paths = sorted((SAMPLES / "aramis-sections" / "vCo_TestMovementCorrected").glob("*.txt"))
    assert len(paths) == 126
    for path in paths:
        record = read_native(path)
        assert isinstance(record, ChannelRecord)
        assert (record.traits.missing, record.traits.decimal, set(record.channels)) == (0, ",", {"Sectionlength", "deltaL"})
        assert record.traits.header["stage"] == path.stem.rsplit("-", 1)[1]
        assert len(record.channels["deltaL"]) == len(path.read_text().splitlines()) - 1
        assert (np.diff(record.channels["Sectionlength"]) > 0.0).all()


@pytest.mark.parametrize(("kind", "points"), [("raw", 5475), ("interpolated", 1124)])
def test_plate_with_a_hole(kind: str, points: int) -> None:
    stage = read_native(DATA / "s235-plate-hole-dic" / f"20231116_displacements_{kind}.csv")
    assert isinstance(stage, DicStage)
    assert (len(stage.point_id), stage.length_unit, stage.traits.missing, stage.stage) == (points, "mm", 0, None)
    field, _ = read_dic_files(stage.traits.path, Rules(times=(60.0,)))
    assert field.displacement.shape == (1, points, 3)
