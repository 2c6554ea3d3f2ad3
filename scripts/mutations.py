"""Do the tests notice a wrong formula? Mutations of a kept list, one at a time, in a copy of the tree; the tests that mirror each are run.

`scripts/mutations.yaml` holds them: file, old text, new text, what that breaks, tests. The old text must stand in its file exactly once, so
that the list cannot rot in silence. A mutation is noticed where its tests fail; where they pass, nothing holds that rule. What was judged
is kept in runs/mutations.json by the digest of sources and tests, so that a run resumes where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml

from thermofit.core.atomic import replacing
from thermofit.core.digest import path_digest
from thermofit.core.folders import CACHE_VARIABLE

ROOT = Path(__file__).resolve().parent.parent
LIST = ROOT / "scripts" / "mutations.yaml"
KEPT = ROOT / "runs" / "mutations.json"
JUDGED_BY = ("thermofit", "tests", "scripts", "docs", "configs", "pyproject.toml")
"""What the answers depend on."""
LIMIT = 300.0
"""s after which a run that a mutation keeps from ending is stopped; it counts as noticed."""
WHOLE = 3600.0
"""The same of all tests together without any mutation."""
PASSED, FAILED, BROKEN = 0, 1, 2
"""Exit codes of pytest: all pass, some fail, tests cannot even be collected. Any other is a mistake of the list."""


class Wrong(Exception):
    """A mistake of the list or of the tree, in one sentence."""


@dataclass(frozen=True)
class Mutation:
    """One wrong edit: `old` text of a `file`, the `new` one in its stead, what it `breaks` in words, and the `tests` that mirror it."""

    name: str
    file: str
    old: str
    new: str
    breaks: str
    tests: tuple[str, ...]

    @property
    def room(self) -> str:
        """Room of the file: effects, diagnose, ..."""
        return Path(self.file).parts[1]


@dataclass(frozen=True)
class Answer:
    """What the tests said of one mutation."""

    name: str
    room: str
    noticed: bool
    by: str
    """The first test that failed, or why there is none."""


def listed(path: Path, root: Path) -> tuple[Mutation, ...]:
    """The mutations of a list, each of which applies to the tree. Wrong where one does not."""
    entries = yaml.safe_load(path.read_text(encoding="utf-8"))
    out: dict[str, Mutation] = {}
    for entry in entries["mutations"]:
        if wrong := set(entry) ^ {"name", "file", "old", "new", "breaks", "tests"}:
            raise Wrong(f"{path}: {entry.get('name', entry)}: keys {', '.join(sorted(wrong))} are missing or unknown")
        one = Mutation(**{**entry, "tests": tuple(entry["tests"])})
        if one.name in out:
            raise Wrong(f"{path}: {one.name} is there twice; give each mutation a name of its own")
        if not one.tests or any(not (root / test.partition("::")[0]).exists() for test in one.tests):
            raise Wrong(f"{path}: {one.name}: tests are {', '.join(one.tests) or 'missing'}; expected files of tests that exist")
        mutated(one, root)
        out[one.name] = one
    return tuple(out.values())


def mutated(one: Mutation, root: Path) -> str:
    """The text of the file with the mutation. Wrong where the old text is not there exactly once, or nothing changes."""
    file = root / one.file
    text = file.read_text(encoding="utf-8") if file.is_file() else ""
    count = text.count(one.old)
    if count != 1:
        raise Wrong(f"{one.name}: the old text is {count} times in {one.file}, expected once; correct the list: {one.old!r}")
    if one.old == one.new:
        raise Wrong(f"{one.name}: old and new text are the same")
    return text.replace(one.old, one.new)


def copied(root: Path, to: Path) -> Path:
    """A copy of all files of the tree that git knows or would take in, with their times, its package compiled to bytecode."""
    names = subprocess.run(["git", "ls-files", "-coz", "--exclude-standard"], cwd=root, capture_output=True, text=True, check=True).stdout
    for name in filter(None, names.split("\0")):
        if (root / name).is_file():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, to / name)
    subprocess.run([sys.executable, "-m", "compileall", "-q", str(to / "thermofit")], check=True)
    return to


def ran(tree: Path, tests: Sequence[str], limit: float = LIMIT) -> tuple[int, str]:
    """Exit code of pytest on a copy, up to the first failure, and the name of that. Wrong where pytest could not do as it was told.

    No bytecode of a mutation is kept: Python tells an edit by the second, and two mutations of a file may share one.
    """
    own = {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", CACHE_VARIABLE: str(tree / ".cache"), "CI": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(command, cwd=tree, env={**os.environ, **own}, capture_output=True, text=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        return FAILED, f"stopped after {limit:g} s"
    if done.returncode not in (PASSED, FAILED, BROKEN):
        raise Wrong(f"pytest {' '.join(tests)} ended with {done.returncode}: {(done.stdout + done.stderr)[-500:]}")
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return done.returncode, failed[0].partition(" - ")[0] if failed else ""


def judged(tree: Path, one: Mutation) -> Answer:
    """The answer to one mutation of a copy, which is left as it was."""
    file = tree / one.file
    times, original = file.stat(), file.read_text(encoding="utf-8")
    file.write_text(mutated(one, tree), encoding="utf-8")
    try:
        code, first = ran(tree, one.tests)
    finally:
        file.write_text(original, encoding="utf-8")
        os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    return Answer(one.name, one.room, code != PASSED, first)


def all_judged(
    todo: Sequence[Mutation], root: Path, jobs: int, kept: Callable[[Answer], None], copy: Callable[[Path, Path], Path] = copied
) -> None:
    """Judge mutations side by side, each process with a copy of its own. Wrong where tests fail without any mutation."""
    with tempfile.TemporaryDirectory(prefix="thermofit-mutations-") as folder:
        trees: queue.SimpleQueue[Path] = queue.SimpleQueue()
        for k in range(jobs):
            trees.put(copy(root, Path(folder) / str(k)))

        def in_a_copy(task: Callable[[Path], Any]) -> Any:
            tree = trees.get()
            try:
                return task(tree)
            finally:
                trees.put(tree)

        every = sorted({test for one in todo for test in one.tests})

        def whole(tree: Path, tests: Sequence[str]) -> None:
            code, first = ran(tree, tests, limit=WHOLE)
            if code != PASSED:
                raise Wrong(f"without any mutation {first or 'a test'} fails: mend it first, or all mutations look noticed")

        with ThreadPoolExecutor(jobs) as pool:
            parts = [every[k::jobs] for k in range(min(jobs, len(every)))]
            for part in [pool.submit(in_a_copy, lambda tree, tests=tests: whole(tree, tests)) for tests in parts]:
                part.result()
            waiting = [pool.submit(in_a_copy, lambda tree, one=one: judged(tree, one)) for one in todo]
            try:
                for done in as_completed(waiting):
                    kept(done.result())
            except BaseException:
                pool.shutdown(wait=True, cancel_futures=True)
                raise


def by_room(answers: Iterable[Answer]) -> dict[str, tuple[int, int]]:
    """Noticed and all, by room."""
    out: dict[str, tuple[int, int]] = {}
    for one in sorted(answers, key=lambda a: a.room):
        noticed, whole = out.get(one.room, (0, 0))
        out[one.room] = (noticed + one.noticed, whole + 1)
    return out


def _state(root: Path) -> str:
    """What the answers depend on, in short."""
    return json.dumps([path_digest(root / name) for name in JUDGED_BY if (root / name).exists()])


def _told(answers: Mapping[str, Answer], mutations: Sequence[Mutation]) -> None:
    for room, (noticed, whole) in by_room(answers.values()).items():
        print(f"{room:12s} {noticed} of {whole} noticed")
    for one in mutations:
        if one.name in answers and not answers[one.name].noticed:
            print(f"not noticed: {one.name} ({one.file}): {one.breaks}")


def main() -> int:
    """0 where enough is noticed, 1 where not, 2 for a mistake of the list or of the tree."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", default=[], metavar="TEXT", help="mutations whose name or file holds one of these texts")
    parser.add_argument("--jobs", type=int, default=1, help="test processes side by side")
    parser.add_argument("--least", type=float, default=0.95, help="share that has to be noticed")
    parser.add_argument("--json", action="store_true", help="answers as JSON")
    parser.add_argument("--force", action="store_true", help="judge again what is known")
    options = parser.parse_args()
    try:
        every = listed(LIST, ROOT)
        chosen = [one for one in every if not options.only or any(text in f"{one.name} {one.file}" for text in options.only)]
        if not chosen:
            raise Wrong(f"no mutation with {' or '.join(options.only)} in its name or file is in {LIST}")
        state = _state(ROOT)
        stored = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
        known = {name: Answer(**a) for name, a in stored.get("answers", {}).items()} if stored.get("state") == state else {}
        answers = {} if options.force else {one.name: known[one.name] for one in chosen if one.name in known}

        def kept(answer: Answer) -> None:
            answers[answer.name] = known[answer.name] = answer
            with replacing(KEPT) as partial:
                partial.write_text(
                    json.dumps({"state": state, "answers": {name: asdict(a) for name, a in known.items()}}), encoding="utf-8"
                )
            print(f"{'noticed' if answer.noticed else 'NOT NOTICED'}: {answer.name}  {answer.by}", file=sys.stderr, flush=True)

        if todo := [one for one in chosen if one.name not in answers]:
            all_judged(todo, ROOT, options.jobs, kept)
    except Wrong as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    share = sum(a.noticed for a in answers.values()) / len(answers)
    if options.json:
        rooms = {room: {"noticed": noticed, "all": whole} for room, (noticed, whole) in by_room(answers.values()).items()}
        print(json.dumps({"noticed": share, "rooms": rooms, "answers": [asdict(answers[one.name]) for one in chosen]}, indent=1))
    else:
        _told(answers, chosen)
    return 0 if share >= options.least else 1


if __name__ == "__main__":
    sys.exit(main())
