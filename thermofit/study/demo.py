"""The quickstart study, which comes with the package: a small virtual experiment."""

from __future__ import annotations

from pathlib import Path

from thermofit.core.errors import StudyError

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
