"""Which artefacts no longer follow from what they were made of: an input has changed since, or an input of an input.

What is not where it was is no reason: a run folder may be read where its raw data are not. Neither is a folder of data in which the
artefact itself lies: every stage changes it.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from thermofit.core.digest import file_digest, path_digest, source_digest
from thermofit.core.errors import StudyError, ThermofitError
from thermofit.records.artefact import Record, open_record, read_record

_ARTEFACT = ".h5"


def stale(record: Record) -> tuple[str, ...]:
    """What an artefact was made of and is no longer so, in words, one for each input; empty where it still follows from its inputs."""
    found = []
    for name, digest in record.inputs.items():
        path = Path(record.attributes["input_paths"].get(name, ""))
        if path == Path() or not path.exists() or path.absolute() == record.path.absolute().parent:
            continue
        what = path.name if path.suffix == _ARTEFACT else f"{name} '{path}'"
        if path_digest(path, _untouched, record.path.parent) != digest:
            found.append(f"{what} has changed since")
        elif path.suffix == _ARTEFACT and (deeper := _stale_artefact(path)):
            found.append(f"{what}, from which it was made, is stale itself: {deeper[0]}")
    return tuple(found)


def other_sources(record: Record) -> str:
    """A sentence where another thermofit, or other effect files, have made an artefact than would make it now; else empty."""
    made, now = str(record.attributes["source_digest"]), source_digest()
    if made == now:
        return ""
    return f"it was made by other sources of thermofit or of effect files ({made[:12]}, version {record.attributes['thermofit_version']})"


def read_current(path: Path, stage: str, study_file: str) -> Record:
    """Open the artefact of a stage that the next stage reads. Errors as `read_record`; StudyError where it is stale: the chain makes it
    anew, a single stage does not."""
    record = read_record(path, stage, f"thermofit {stage} {study_file}")
    if reasons := stale(record):
        again = f"run `thermofit run {study_file} --until {stage}`, which makes anew what is stale"
        raise StudyError(f"{path} is stale: {reasons[0]}; {again}")
    return record


def _stale_artefact(path: Path) -> tuple[str, ...]:
    """Of an artefact among the inputs; one that cannot be read is said by whoever reads it."""
    try:
        return stale(open_record(path))
    except ThermofitError:
        return ()


def _untouched(path: Path) -> str:
    """Digest of a file; one that has not been touched is not read twice in a process, for every stage asks for the raw data."""
    state = path.stat()
    return _of_state(path, state.st_mtime_ns, state.st_ctime_ns, state.st_size, state.st_ino)


@lru_cache(maxsize=4096)
def _of_state(path: Path, modified: int, changed: int, size: int, inode: int) -> str:
    return file_digest(path)
