"""Files of a study: relative to its folder, with variables of the environment; which effect files are used for the first time; the demo."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from thermofit.core.digest import file_digest
from thermofit.core.errors import StudyError
from thermofit.core.files import cache_root

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


NAME = "quickstart.yaml"
_HERE = Path(__file__).resolve().parent
_PLACES = (_HERE / NAME, _HERE.parents[1] / "configs" / NAME)
"""In an installed package; in a clone, whose `configs` the wheel takes it from."""


def demo_study(folder: str | Path = "thermofit-demo") -> Path:
    """Put the quickstart study into a folder, unless there is one already; returns its path. StudyError where it cannot be written."""
    target = Path(folder) / NAME
    if target.exists():
        return target
    source = next((path for path in _PLACES if path.is_file()), None)
    if source is None:
        raise StudyError(f"the quickstart study is missing from this installation (expected {_PLACES[0]}); install thermofit again")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(source.read_bytes())
    except OSError as error:
        raise StudyError(
            f"'{target}' cannot be written ({error.strerror or error}); expected a writable folder, name one by --to"
        ) from None
    return target


_SEEN = "effects-used"


def first_uses(files: Sequence[Path]) -> list[Path]:
    """Those of the effect files whose content has not been used from where it stands; from now on it has."""
    new = []
    for path in files:
        mark = cache_root() / _SEEN / hashlib.sha256(f"{path.absolute()}\0{file_digest(path)}".encode()).hexdigest()
        if not mark.exists():
            new.append(path)
            with suppress(OSError):  # where nothing can be kept it is said every time
                mark.parent.mkdir(parents=True, exist_ok=True)
                mark.touch()
    return new


def notice(study: Path, file: Path) -> str:
    """What the user reads before an effect file is used for the first time."""
    return f"note: first use of the effect file {file.absolute()}, which key 'effects' of {study} names: it is run as Python code"
