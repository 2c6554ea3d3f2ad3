"""What is this file: recognised by content, read whole, described part by part."""

from __future__ import annotations

from thermofit.core.errors import DataError
from thermofit.measure.findings import Finding, Part, units_of
from thermofit.measure.formats.contents import Content, DicSequence, DicStage, Head, Record, Records, ScalarField, ThermalFrames
from thermofit.measure.formats.registry import FORMATS
from thermofit.measure.look_field import look_at_frames, look_at_matrix, look_at_sequence, look_at_stage
from thermofit.measure.look_record import look_at_record, look_at_records
from thermofit.measure.own_files import first_line


def native_format(head: Head) -> str:
    """Name of the native format of a file, "" where none is recognised."""
    return next((str(module.NAME) for module in FORMATS if module.recognises(head)), "")


def read_recognised(head: Head) -> Content:
    """The content of a native file. DataError, with the first line quoted, where no format is recognised, and for every defect."""
    module = next((module for module in FORMATS if module.recognises(head)), None)
    if module is None:
        raise DataError(
            f"{head.path}: no known format recognised in its content ({first_line(head)}), expected an export of a DIC system, an infrared "
            f"camera or a testing machine; docs/formats.md lists the formats, export it as one of them"
        )
    content: Content = module.read(head.path)
    return content


def look_at(content: Content) -> Finding:
    """Everything that can be said of a content."""
    parts = _parts(content)
    tests = content.tests.values() if isinstance(content, Records) else ()
    columns = [*content.traits.columns, *(column for test in tests for column in test.traits.columns)]
    kind = parts[0].kind if len(parts) == 1 else f"{len(parts)} records"
    return Finding(content.traits, kind, parts, units_of(columns))


def _parts(content: Content) -> tuple[Part, ...]:
    if isinstance(content, DicStage):
        return (look_at_stage(content),)
    if isinstance(content, DicSequence):
        return (look_at_sequence(content),)
    if isinstance(content, ThermalFrames):
        return (look_at_frames(content),)
    if isinstance(content, ScalarField):
        return (look_at_matrix(content),)
    return (look_at_record(content),) if isinstance(content, Record) else look_at_records(content)
