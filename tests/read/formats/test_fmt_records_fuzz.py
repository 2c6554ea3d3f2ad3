"""Damaged copies of coupon records: every reader answers with sound content or a DataError of one sentence."""

from __future__ import annotations

from functools import partial
from types import ModuleType

import pytest
from fuzz import MUTATIONS, mutate, mutations, survives
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from record_layouts import (
    BARE,
    CATMAN,
    CATMAN_TWO_RATES,
    COMMENTED,
    DATED,
    INSTRON,
    MACHINE,
    MATLAB_CELLS,
    MATLAB_FLAT,
    MATLAB_PACKED,
    PLACED,
    PLAIN,
    RESULTS,
    SANDIA,
    SCHENCK,
    STATED,
    TESTXPERT,
    TESTXPERT_BOOK,
    TESTXPERT_BOOKS,
    TESTXPERT_TABS,
    remade,
)

from thermofit.core.errors import DataError
from thermofit.read.formats import (
    bare_table,
    catman_workbook,
    coupon_text,
    machine_workbook,
    matlab_tests,
    sandia_text,
    testxpert_text,
    testxpert_workbook,
)
from thermofit.read.formats.registry import head_of, read_native

SEEDS: dict[str, tuple[ModuleType, str, tuple[bytes, ...]]] = {
    "coupon_text": (coupon_text, "record.csv", (PLAIN, INSTRON, SCHENCK, COMMENTED, STATED, RESULTS, DATED, PLACED)),
    "bare_table": (bare_table, "bare.csv", (BARE,)),
    "sandia_text": (sandia_text, "state.csv", (SANDIA,)),
    "testxpert_text": (testxpert_text, "record.txt", (TESTXPERT, TESTXPERT_TABS)),
    "machine_workbook": (machine_workbook, "machine.xlsx", (MACHINE,)),
    "catman_workbook": (catman_workbook, "catman.xlsx", (CATMAN, CATMAN_TWO_RATES)),
    "testxpert_workbook": (testxpert_workbook, "test.xlsx", (TESTXPERT_BOOK, TESTXPERT_BOOKS)),
    "matlab_tests": (matlab_tests, "tests.mat", (MATLAB_CELLS, MATLAB_PACKED, MATLAB_FLAT)),
}
STEPS = st.lists(st.tuples(st.integers(0, len(MUTATIONS) - 1), st.integers(0, 2**32)), min_size=1, max_size=5)


def check(name: str, data: st.DataObject, folder: pytest.TempPathFactory) -> None:
    """The reader itself, and recognition, on one damaged copy; workbooks are damaged as an archive or inside their sheets."""
    module, file, seeds = SEEDS[name]
    path = folder.getbasetemp() / file
    if file.endswith(".xlsx") and data.draw(st.booleans()):
        damaged = remade(data.draw(st.sampled_from(seeds)), partial(mutate, steps=data.draw(STEPS)))
    else:
        damaged = data.draw(mutations(*seeds))
    survives(module.read, path, damaged)
    if damaged:
        assert module.recognises(head_of(path)) in (True, False)


@pytest.mark.parametrize("name", SEEDS)
@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_damaged_record(name: str, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    check(name, data, tmp_path_factory)


@pytest.mark.slow
@pytest.mark.parametrize("name", SEEDS)
@settings(max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_damaged_record_often(name: str, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    check(name, data, tmp_path_factory)


@pytest.mark.parametrize("name", SEEDS)
def test_whole_file_is_read(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Without damage every seed is read, and recognised as what it is: the fuzzing is not vacuous."""
    module, file, seeds = SEEDS[name]
    path = tmp_path_factory.mktemp(name) / file
    for seed in seeds:
        content = survives(module.read, path, seed)
        assert content is not None
        assert read_native(path).traits.format == module.NAME


@pytest.mark.parametrize("name", SEEDS)
def test_beginning_of_a_file_is_no_content_of_another_shape(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Every truncation at a tenth of the file is content of fewer rows or an error."""
    module, file, seeds = SEEDS[name]
    path = tmp_path_factory.mktemp(name) / file
    for tenth in range(1, 10):
        survives(module.read, path, seeds[0][: len(seeds[0]) * tenth // 10])
    path.unlink()
    with pytest.raises(DataError, match="no such file"):
        read_native(path)
