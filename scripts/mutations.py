"""Do the tests notice a wrong formula? Mutations of a kept list, one at a time, in a copy of the tree; the tests that mirror each are run.

`scripts/mutations.yaml` holds them: file, old text, new text, what that breaks, tests. The old text must stand in its file exactly once, so
that the list cannot rot in silence. A mutation is noticed where its tests fail; where they pass, nothing holds that rule.

Answers are rows of docs/mutations.jsonl. One holds until the entry, the mutated file, its tests or what these take from tests/support
change; the rest of the package may have changed meanwhile, so each row names the sources by which it was judged, and the page says how many
are of earlier ones (`--here` judges these again). A test that noticed it before is run first. docs/tests.md shows the share by room.
"""

from __future__ import annotations

import argparse
import ast
import fcntl
import hashlib
import json
import os
import queue
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

import yaml

from thermofit.core.files import CACHE_VARIABLE, replacing

ROOT = Path(__file__).resolve().parent.parent
LIST = ROOT / "scripts" / "mutations.yaml"
ROWS = ROOT / "docs" / "mutations.jsonl"
PAGE = ROOT / "docs" / "tests.md"
BEGIN, END = "<!-- mutations: begin -->", "<!-- mutations: end -->"
"""Between these lines of the page stands what `scripts/mutations.py` writes."""
COPIES = ROOT / "runs" / "mutations"
"""Copies of the tree: they stay, with the kernels that were compiled in them."""
LIMIT = 300.0
"""s of CPU after which a run that a mutation keeps from ending is stopped; it counts as noticed."""
WAIT = 1800.0
"""s of any time after which such a run is stopped: a wait without end uses no CPU."""
COMPILED = ("law", "point", "body")
"""Rooms of kernels; tests of the effects call their formulas as they stand."""
PASSED, FAILED, BROKEN, NOT_THERE = 0, 1, 2, 4
"""Exit codes of pytest: all pass, some fail, tests cannot even be collected, a test of that name is not there."""


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
    of: str
    """Digest of entry, mutated file and tests: an answer of another one does not hold."""
    sources: str
    """Digest of package and tests when it was judged."""
    seconds: float
    """Time that the tests took."""


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


def digest(*texts: str) -> str:
    """Short digest of some texts."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:12]


def sources(root: Path, *folders: str) -> str:
    """Digest of all Python sources of some folders; what Python compiled of them is no source."""
    files = sorted(path for folder in folders for path in (root / folder).rglob("*.py"))
    return digest(*(f"{path.relative_to(root)}\0{path.read_text(encoding='utf-8')}" for path in files))


def with_helpers(root: Path, tests: Sequence[str]) -> list[Path]:
    """The files of some tests, and what they import, directly or not, of tests/support."""
    todo = [root / "tests" / "conftest.py"]
    for name in tests:
        path = root / name.partition("::")[0]
        todo += sorted(path.rglob("*.py")) if path.is_dir() else [path]
    found: set[Path] = set()
    while todo:
        path = todo.pop()
        if path in found or not path.is_file():
            continue
        found.add(path)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            todo += [root / "tests" / "support" / f"{name}.py" for name in names]
    return sorted(found)


def holds_for(one: Mutation, root: Path) -> str:
    """Digest of what an answer is an answer to: the entry, the file that it mutates, its tests and their helpers."""
    files = [root / one.file, *with_helpers(root, one.tests)]
    return digest(one.old, one.new, *one.tests, *(path.read_text(encoding="utf-8") for path in files))


def copied(root: Path, to: Path) -> Path:
    """A copy of all files of the tree that git knows or would take in, with their times, its package compiled to bytecode.

    An earlier copy in the same place is brought up to date: files that are gone go, caches stay.
    """
    listing = subprocess.run(["git", "ls-files", "-coz", "--exclude-standard"], cwd=root, capture_output=True, text=True, check=True).stdout
    names = {name for name in listing.split("\0") if name and (root / name).is_file()}
    for path in to.rglob("*"):
        name = path.relative_to(to)
        if path.is_file() and name.parts[0] != ".cache" and "__pycache__" not in name.parts and str(name) not in names:
            path.unlink()
    for name in names:
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

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit) + 5))

    try:
        done = subprocess.run(
            command, cwd=tree, env={**os.environ, **own}, capture_output=True, text=True, timeout=WAIT, check=False, preexec_fn=limited
        )
    except subprocess.TimeoutExpired:
        return FAILED, f"stopped after {WAIT:g} s"
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return FAILED, f"stopped after {limit:g} s of CPU"
    if done.returncode not in (PASSED, FAILED, BROKEN, NOT_THERE):
        raise Wrong(f"pytest {' '.join(tests)} ended with {done.returncode}: {(done.stdout + done.stderr)[-500:]}")
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return done.returncode, failed[0].partition(" - ")[0] if failed else ""


def judged(tree: Path, one: Mutation, before: Answer | None = None) -> tuple[bool, str]:
    """Is a mutation noticed in a copy, and by which test; the copy is left as it was. The test that noticed it `before` is run first."""
    file = tree / one.file
    times, original = file.stat(), file.read_text(encoding="utf-8")
    file.write_text(mutated(one, tree), encoding="utf-8")
    _, _, known = before.by.partition("FAILED ") if before is not None and before.noticed else ("", "", "")
    try:
        code, first = ran(tree, [known]) if known else (PASSED, "")
        if code in (PASSED, NOT_THERE):
            code, first = ran(tree, one.tests)
    finally:
        file.write_text(original, encoding="utf-8")
        os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    if code == NOT_THERE:
        raise Wrong(f"{one.name}: {', '.join(one.tests)} are not tests of the tree; correct the list")
    return code != PASSED, first


def own_copies(root: Path, jobs: int, copy: Callable[[Path, Path], Path] = copied) -> Iterator[Path]:
    """Copies of the tree that no other process uses: each holds a lock on its folder until it ends."""
    k = 0
    while jobs:
        folder = COPIES / str(k)
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder.with_suffix(".lock"), os.O_CREAT | os.O_RDWR)
        k += 1
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        jobs -= 1
        yield copy(root, folder)


def all_judged(todo: Sequence[Mutation], copies: Iterable[Path], kept: Callable[[Answer], None], before: Mapping[str, Answer]) -> None:
    """Judge mutations side by side, each process with a copy of its own. Wrong where tests fail without any mutation.

    Tests are run once without a mutation before the first one that they mirror, so that what is judged is kept from the beginning.
    """
    trees: queue.SimpleQueue[Path] = queue.SimpleQueue()
    made = list(copies)
    for tree in made:
        trees.put(tree)
    # Of the copies: the tree itself may be edited meanwhile.
    now = sources(made[0], "thermofit", "tests")
    whole: dict[str, threading.Lock] = {test: threading.Lock() for one in todo for test in one.tests}
    sound: set[str] = set()

    def one_judged(one: Mutation) -> Answer:
        tree = trees.get()
        try:
            for test in one.tests:
                with whole[test]:
                    if test not in sound:
                        code, first = ran(tree, [test], limit=WAIT)
                        if code != PASSED:
                            raise Wrong(f"without any mutation {first or test} fails: mend it first, or all mutations look noticed")
                        sound.add(test)
            begin = time.monotonic()
            noticed, by = judged(tree, one, before.get(one.name))
            return Answer(one.name, one.room, noticed, by, holds_for(one, tree), now, round(time.monotonic() - begin, 1))
        finally:
            trees.put(tree)

    with ThreadPoolExecutor(len(made)) as pool:
        waiting = [pool.submit(one_judged, one) for one in todo]
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


def known_rows(path: Path) -> dict[str, Answer]:
    """The kept answers by name, whether or not they still hold."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {row["name"]: Answer(**row) for row in map(json.loads, lines)}


def write_rows(path: Path, rows: Mapping[str, Answer], every: Sequence[Mutation]) -> None:
    """Keep the answers, in the order of the list; those to mutations that the list no longer holds go."""
    with replacing(path) as partial:
        text = "".join(json.dumps(asdict(rows[one.name])) + "\n" for one in every if one.name in rows)
        partial.write_text(text, encoding="utf-8")


def shown(text: str, answers: Mapping[str, Answer], every: Sequence[Mutation], now: str) -> str:
    """The page with the share noticed by room, of the answers that hold; Wrong where it has no place for that."""
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise Wrong(f"{PAGE}: expected the lines {BEGIN} and {END} once each")
    held = [answers[one.name] for one in every if one.name in answers]
    whole = {room: sum(one.room == room for one in every) for room in {one.room for one in every}}
    share, missed = sum(a.noticed for a in held), [a.name for a in held if not a.noticed]
    lines = ["| package | mutations | judged | noticed |", "| --- | --- | --- | --- |"]
    rooms = by_room(held)
    for room, number in sorted(whole.items(), key=lambda one: (-one[1], one[0])):
        noticed, judged = rooms.get(room, (0, 0))
        lines.append(f"| `{room}/` | {number} | {judged} | {noticed} |")
    lines += [f"| all | {len(every)} | {len(held)} | {share} |", ""]
    lines.append(f"Not noticed: {', '.join(f'`{name}`' for name in missed) or 'none'}.")
    earlier = sum(a.sources != now for a in held)
    lines.append(f"Of these answers, {earlier} were given on earlier sources of the package and hold by the rule above.")
    return text[: text.index(BEGIN)] + "\n".join([BEGIN, "", *lines, "", ""]) + text[text.index(END) :]


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
    parser.add_argument("--page", action="store_true", help="write what is kept to docs/tests.md, and judge nothing")
    parser.add_argument("--here", action="store_true", help="judge again what was judged on other sources of package and tests")
    options = parser.parse_args()
    try:
        every = listed(LIST, ROOT)
        chosen = [one for one in every if not options.only or any(text in f"{one.name} {one.file}" for text in options.only)]
        if not chosen:
            raise Wrong(f"no mutation with {' or '.join(options.only)} in its name or file is in {LIST}")
        rows = known_rows(ROWS)
        now = sources(ROOT, "thermofit", "tests")
        of = {one.name: holds_for(one, ROOT) for one in chosen}

        def holds(name: str) -> bool:
            row = rows.get(name)
            return row is not None and row.of == of[name] and (row.sources == now or not options.here)

        answers = {} if options.force else {one.name: rows[one.name] for one in chosen if holds(one.name)}

        def kept(answer: Answer) -> None:
            answers[answer.name] = rows[answer.name] = answer
            write_rows(ROWS, rows, every)
            said = f"{'noticed' if answer.noticed else 'NOT NOTICED'}: {answer.name}  {answer.by}  {answer.seconds} s"
            print(said, file=sys.stderr, flush=True)

        # Those of kernels last: each compiles what it changes.
        todo = sorted((one for one in chosen if one.name not in answers), key=lambda one: one.room in COMPILED)
        if todo and not options.page:
            all_judged(todo, own_copies(ROOT, min(options.jobs, len(todo))), kept, rows)
        if len(chosen) == len(every):
            text = shown(PAGE.read_text(encoding="utf-8"), answers, every, now)
            with replacing(PAGE) as partial:
                partial.write_text(text, encoding="utf-8")
    except Wrong as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    share = sum(a.noticed for a in answers.values()) / max(len(answers), 1)
    if options.json:
        rooms = {room: {"noticed": noticed, "all": whole} for room, (noticed, whole) in by_room(answers.values()).items()}
        earlier = sum(answer.sources != now for answer in answers.values())
        told = [asdict(answers[one.name]) for one in chosen]
        print(json.dumps({"noticed": share, "earlier": earlier, "rooms": rooms, "answers": told}, indent=1))
    else:
        _told(answers, chosen)
    return 0 if share >= options.least else 1


if __name__ == "__main__":
    sys.exit(main())
