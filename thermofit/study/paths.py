"""Paths of a study: relative to its folder, with variables of the environment."""

from __future__ import annotations

import os
import re
from pathlib import Path

from thermofit.core.errors import StudyError

_VARIABLE = re.compile(r"\$\{([^}]*)\}")


def expanded(text: str, where: str) -> str:
    """The text with each ${VARIABLE} replaced by the environment's value; `where` names file and key.

    StudyError where a variable is not set.
    """

    def value(match: re.Match[str]) -> str:
        name = match.group(1)
        if not os.environ.get(name):
            raise StudyError(f"{where} is '{text}', but the environment variable {name} is not set: export {name}=FOLDER")
        return os.environ[name]

    return _VARIABLE.sub(value, text)


def path_from(folder: Path, text: str, where: str) -> Path:
    """The path that a text of the study names: relative to `folder`, ~ and ${VARIABLES} replaced. StudyError where it names none."""
    plain = expanded(text, where)
    if "\0" in plain:
        raise StudyError(f"{where} is {plain!r}, which holds a zero byte; expected the name of a file or folder")
    try:
        return folder.absolute() / Path(plain).expanduser()
    except RuntimeError:
        raise StudyError(f"{where} is '{plain}', but the home folder of that user is not known; give the path without ~") from None
