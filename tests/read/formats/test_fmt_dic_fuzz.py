"""Damaged copies of DIC exports: every reader answers with sound content or a DataError of one sentence."""

from __future__ import annotations

from types import ModuleType

import pytest
from fuzz import mutations, survives
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from layouts import (
    ARAMIS,
    ARAMIS_COMMAS,
    CONNECTIONS,
    GOM,
    LEGACY,
    LEGACY_COORDINATES,
    LEGACY_DISPLACEMENTS,
    LOAD,
    MATCHID,
    MATCHID_3D,
    MATRIX,
    NODEMAP,
    SECTION,
    TABLE,
)

from thermofit.core.errors import DataError
from thermofit.read.formats import (
    aramis_csv,
    aramis_legacy,
    aramis_section,
    dic_table,
    dlr_nodemap,
    gom_points,
    matchid_load,
    matchid_matrix,
    matchid_table,
)
from thermofit.read.formats.registry import head_of, read_native

SEEDS: dict[str, tuple[ModuleType, str, tuple[bytes, ...]]] = {
    "aramis_csv": (aramis_csv, "component_21.5 s.csv", (ARAMIS, ARAMIS_COMMAS)),
    "gom_points": (gom_points, "points_0151.csv", (GOM,)),
    "dlr_nodemap": (dlr_nodemap, "nodes_1_52.txt", (NODEMAP, CONNECTIONS)),
    "aramis_legacy": (aramis_legacy, "a-Stage-0-12.txt", (LEGACY, LEGACY_COORDINATES, LEGACY_DISPLACEMENTS)),
    "aramis_section": (aramis_section, "section0_0-1.txt", (SECTION,)),
    "matchid_table": (matchid_table, "image.bmp 1.csv", (MATCHID, MATCHID_3D)),
    "matchid_matrix": (matchid_matrix, "image7_0.tif_U[mm].csv", (MATRIX,)),
    "matchid_load": (matchid_load, "Image.csv", (LOAD,)),
    "dic_table": (dic_table, "table.csv", (TABLE,)),
}


def check(name: str, data: st.DataObject, folder: pytest.TempPathFactory) -> None:
    """The reader itself, and recognition, on one damaged copy."""
    module, file, seeds = SEEDS[name]
    path = folder.getbasetemp() / file
    damaged = data.draw(mutations(*seeds))
    survives(module.read, path, damaged)
    survives(read_native, path, damaged)
    if damaged:
        assert module.recognises(head_of(path)) in (True, False)


@pytest.mark.parametrize("name", SEEDS)
@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_damaged_file(name: str, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    check(name, data, tmp_path_factory)


@pytest.mark.slow
@pytest.mark.parametrize("name", SEEDS)
@settings(max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_500_damaged_files(name: str, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    check(name, data, tmp_path_factory)


@pytest.mark.parametrize("name", SEEDS)
def test_seeds_are_read_and_recognised_by_their_reader_only(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    module, file, seeds = SEEDS[name]
    path = tmp_path_factory.mktemp(name) / file
    for seed in seeds:
        content = survives(read_native, path, seed)
        assert content is not None or seed is CONNECTIONS
        assert module.recognises(head_of(path))
        if content is not None:
            assert content.traits.format == module.NAME


def test_every_reader_refuses_the_others_files(tmp_path_factory: pytest.TempPathFactory) -> None:
    """A file of the wrong kind given to a reader by force."""
    folder = tmp_path_factory.mktemp("wrong")
    for module, _, _ in SEEDS.values():
        for other, file, seeds in SEEDS.values():
            path = folder / file
            path.write_bytes(seeds[0])
            if module is not other and not module.recognises(head_of(path)):
                with pytest.raises(DataError, match=r"expected"):
                    module.read(path)
