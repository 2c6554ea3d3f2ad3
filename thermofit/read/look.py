"""What is this file: its content described part by part."""

from __future__ import annotations

from thermofit.read.findings import Finding, Part, units_of
from thermofit.read.formats.contents import Content, DicSequence, DicStage, Record, Records, ScalarField, ThermalFrames
from thermofit.read.look_field import look_at_frames, look_at_matrix, look_at_sequence, look_at_stage
from thermofit.read.look_record import look_at_record, look_at_records


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
