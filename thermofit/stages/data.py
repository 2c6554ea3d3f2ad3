"""`data list` and `data fetch`: public sets of measured data, where they come from, and how a study finds them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from thermofit.core.errors import StudyError
from thermofit.read.data_sets import (
    DATA_VARIABLE,
    SETS_FOLDER,
    DataSet,
    Downloader,
    data_set,
    data_sets,
    download_root,
    mirror_root,
    obtain,
    present,
)

NAME = "data"


def listing() -> dict[str, Any]:
    """Every set with its files, bytes, licences, origins, citation, and where it is: `present` in words, `complete`.

    StudyError where THERMOFIT_DATA names no folder.
    """
    mirror, cache = mirror_root(), download_root()
    sets = [_described(data, mirror, cache) for data in data_sets().values()]
    complete = sum(1 for entry in sets if entry["complete"])
    hint = f"{DATA_VARIABLE} is {mirror}" if mirror else f"{DATA_VARIABLE} is not set; `thermofit data fetch` says how"
    verdict = f"{len(sets)} public sets, {complete} complete here; {hint}"
    return {"stage": "data-list", "verdict": verdict, "mirror": str(mirror) if mirror else None, "cache": str(cache), "sets": sets}


def _described(data: DataSet, mirror: Path | None, cache: Path) -> dict[str, Any]:
    counts = {"mirror": present(mirror, data) if mirror else 0, "cache": present(cache, data)}
    where = max(counts, key=lambda name: counts[name])
    n, total = counts[where], len(data.files)
    return {
        "name": data.name,
        "title": data.title,
        "files": total,
        "bytes": data.size,
        "licences": list(data.licences),
        "use": data.use,
        "citation": data.citation,
        "origins": [{"project": o.project, "commit": o.commit, "licence": o.licence} for o in data.origins.values()],
        "present": "no" if n == 0 else where if n == total else f"{where}, {n} of {total} files",
        "complete": n == total,
        "local_only": [file.path for file in data.files if file.url is None],
    }


def fetch(
    names: Sequence[str], to: Path | None, *, download: Downloader | None = None, tell: Callable[[str], None] | None = None
) -> dict[str, Any]:
    """Sets (none named: all) taken from the mirror, else downloaded below `to` or the cache; every file is checked by its SHA-256.

    `tell` hears the name of each set before it is fetched. StudyError for an unknown set or a folder that cannot be written, DataError
    for a wrong file and without a network.
    """
    wanted = [data_set(name) for name in names] if names else list(data_sets().values())
    results = []
    for data in wanted:
        if tell:
            tell(f"{data.name}: {len(data.files)} files, {data.size / 1e6:.1f} MB, {', '.join(data.licences)}")
        results.append(_fetched(data, to, download))
    return {"stage": "data-fetch", "verdict": _verdict(results, to), "sets": results}


def _fetched(data: DataSet, to: Path | None, download: Downloader | None) -> dict[str, Any]:
    try:
        got = [(file, *obtain(data, file, to, download)) for file in data.files]
    except OSError as error:
        raise StudyError(f"'{error.filename}' cannot be written ({error.strerror}); name a writable folder with --to") from error
    counts = {how: sum(1 for _, _, h in got if h == how) for how in ("mirror", "there", "downloaded", "not public")}
    remarks = [f"{file.path} is derived ({file.note}) and in no public place" for file, path, _ in got if path is None]
    folders = {str(path).removesuffix(file.path).rstrip("/") for file, path, _ in got if path is not None}
    return {"name": data.name, "folders": sorted(folders), "counts": counts, "remarks": remarks, "citation": data.citation}


def _verdict(results: list[dict[str, Any]], to: Path | None) -> str:
    """One sentence: what was checked, and how THERMOFIT_DATA is to be set so that studies find it."""
    files = sum(sum(r["counts"].values()) - r["counts"]["not public"] for r in results)
    downloaded = sum(r["counts"]["downloaded"] for r in results)
    mirror = mirror_root()
    in_mirror = to is None and mirror is not None and all(r["counts"]["there"] + r["counts"]["downloaded"] == 0 for r in results)
    root = mirror if in_mirror else to or download_root()
    point = f"they lie in {root}/{SETS_FOLDER}, which {DATA_VARIABLE} names" if in_mirror else f"export {DATA_VARIABLE}={root}"
    sets = f"{len(results)} set{'s' if len(results) > 1 else ''}"
    return f"{files} file{'s' if files > 1 else ''} of {sets} checked by SHA-256, {downloaded} of them downloaded; " + (
        point if in_mirror else f"for studies and tests to find them: {point}"
    )
