"""Files that are no native export: thermofit's own (raw folder, study, artefact), pictures; each recognised by its content."""

from __future__ import annotations

from dataclasses import dataclass

from thermofit.core.errors import DataError
from thermofit.core.yaml_text import parse_yaml
from thermofit.read.formats.contents import Head
from thermofit.read.formats.text import head_lines
from thermofit.read.raw_description import DESCRIPTION

HDF5 = b"\x89HDF\r\n\x1a\n"
_PICTURES = {b"II*\x00": "TIFF", b"MM\x00*": "TIFF", b"\x89PNG\r\n\x1a\n": "PNG", b"BM": "BMP", b"\xff\xd8\xff": "JPEG"}


@dataclass(frozen=True)
class Known:
    """What a file is, and what to do with it."""

    format: str
    advice: str


ARTEFACT = Known("thermofit artefact", "`thermofit show FILE` describes it")
STUDY = Known("thermofit study", "`thermofit run FILE` runs it")
EXPERIMENT = Known("thermofit experiment.yaml", "it describes a raw folder: inspect the folder")
STAGE = Known("thermofit DIC stage", "it belongs to a raw folder: inspect the folder with experiment.yaml")
FRAME = Known("thermofit infrared frame", "it belongs to a raw folder: inspect the folder with experiment.yaml")
FORCE = Known("thermofit force record", "it belongs to a raw folder: inspect the folder with experiment.yaml")


def own_file(head: Head) -> Known | None:
    """What a file of thermofit or a picture is, None for anything else."""
    for magic, name in _PICTURES.items():
        if head.first.startswith(magic):
            return Known(f"picture ({name})", "thermofit reads no pictures: correlate them with a DIC program and inspect its export")
    if head.first.startswith(HDF5) and b"thermofit" in head.first:
        return ARTEFACT
    lines = head_lines(head)
    if not lines:
        return None
    if lines[0].startswith("# time_s:"):
        return STAGE if len(lines) > 1 and lines[1].startswith("id,") else FRAME
    if lines[0].replace(" ", "").startswith("time_s,force_N"):
        return FORCE
    return _yaml(head, lines)


def _yaml(head: Head, lines: list[str]) -> Known | None:
    """A study or a description of an experiment: a YAML mapping with the keys that each must have."""
    if head.path.suffix.lower() not in (".yaml", ".yml"):
        return None
    try:
        tree = parse_yaml("\n".join(lines), str(head.path), DataError, text_keys=False)
    except DataError:
        tree = None
    keys = set(tree) if isinstance(tree, dict) else set()
    if head.path.name == DESCRIPTION or {"specimen", "temperatures"} <= keys:
        return EXPERIMENT
    return STUDY if "name" in keys and keys & {"parameters", "experiment", "simulate", "coupon"} else None
