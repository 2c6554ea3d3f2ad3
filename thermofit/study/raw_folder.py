"""What a raw folder declares, before anything of it is read: enough to know what a study on it needs."""

from __future__ import annotations

from pathlib import Path

from thermofit.core.errors import StudyError
from thermofit.core.yaml_text import parse_yaml

_DESCRIPTION = "experiment.yaml"


def has_displacements(folder: Path) -> bool:
    """False where a raw folder declares infrared frames and no displacements. True where it is not there yet, or something is wrong in it,
    which is said where it is read."""
    description = folder / _DESCRIPTION
    if not description.is_file():
        return True
    try:
        tree = parse_yaml(description.read_text(encoding="utf-8"), str(description), StudyError, text_keys=False)
    except (OSError, UnicodeDecodeError, StudyError):
        return True
    return not isinstance(tree, dict) or tree.get("dic") is not None or tree.get("ir") is None
