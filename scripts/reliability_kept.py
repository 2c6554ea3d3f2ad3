"""Inputs that once ended in a mistake of thermofit, in a wait without end or in gigabytes, each through a command of its own.

Raw folders of a small virtual test, its study and native exports, damaged in one way each. Every command has to end with a result or with
one sentence, within the CPU time and the memory that are given; a wait is told by its wall time.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from reliability_study import command, environment, small_study, tiny

from thermofit.study.study import load_study

LIMIT_S = 20.0
LIMIT_MB = 2048.0
WAIT_S = 300.0
"""Wall time after which a command waits for something that does not come."""
LAWFUL = {0, 2, 3, 4, 5}
"""Exit codes that are documented; 1 is a mistake of thermofit."""
BOMB = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join(['*' + a] * 10)}]\n" for a, b in zip("abcdefg", "bcdefgh", strict=True)
)
"""YAML of 300 bytes that stands for 10^8 values."""
Damage = Callable[[Path], None]


@dataclass(frozen=True)
class Case:
    """A command, what is damaged in the raw folder, and keys of the study that are changed."""

    damage: Damage = lambda raw: None
    words: tuple[str, ...] = ("run", "STUDY", "--until", "identify-elastic")
    keys: Mapping[str, Any] | None = None


def force(value: Callable[[int, float], float]) -> Damage:
    """Another force (row, N) in every row."""

    def damage(raw: Path) -> None:
        path = raw / "force.csv"
        head, *rows = path.read_text(encoding="utf-8").splitlines()
        k = head.split(",").index("force_N")
        cells = [row.split(",") for row in rows]
        made = [",".join([*row[:k], repr(value(n, float(row[k]))), *row[k + 1 :]]) for n, row in enumerate(cells)]
        path.write_text("\n".join([head, *made]) + "\n", encoding="utf-8")

    return damage


def points(made: Callable[[list[str]], list[str]]) -> Damage:
    """Other rows of points in every stage."""

    def damage(raw: Path) -> None:
        for path in sorted((raw / "dic").iterdir()):
            head, rows = path.read_text(encoding="utf-8").splitlines()[:2], path.read_text(encoding="utf-8").splitlines()[2:]
            path.write_text("\n".join([*head, *made(rows)]) + "\n", encoding="utf-8")

    return damage


def at_one_place(rows: list[str]) -> list[str]:
    """Every point in the middle."""
    return [",".join([cells[0], "0.0", "0.0", "0.0", *cells[4:]]) for cells in (row.split(",") for row in rows)]


def forty_times(rows: list[str]) -> list[str]:
    """Every point forty times in one place, each with a number of its own."""
    return [f"{40 * int(row.split(',', 1)[0]) + n},{row.split(',', 1)[1]}" for row in rows for n in range(40)]


def many(path: Path) -> None:
    """Two million points more in a stage."""
    cells = path.read_text(encoding="utf-8").splitlines()[2].split(",")
    with path.open("a", encoding="utf-8") as file:
        for k in range(2_000_000):
            file.write(f"{1_000_000 + k},{k % 1500 * 0.01:.4f},{k // 1500 * 0.01:.4f},{','.join(cells[3:])}\n")


def instead(name: str, made: Callable[[Path], None]) -> Damage:
    """Something else in the place of a file of the raw folder; a star stands for its first match."""

    def damage(raw: Path) -> None:
        path = sorted(raw.glob(name))[0]
        path.unlink()
        made(path)

    return damage


def zero(path: Path) -> None:
    """A device that never ends."""
    path.symlink_to("/dev/zero")


def appended(text: str) -> Damage:
    """The description with more text."""

    def damage(raw: Path) -> None:
        with (raw / "experiment.yaml").open("a", encoding="utf-8") as file:
            file.write(text)

    return damage


def both(*damages: Damage) -> Damage:
    """One damage after the other."""

    def damage(raw: Path) -> None:
        for one in damages:
            one(raw)

    return damage


def aramis(raw: Path) -> None:
    """A stage of ARAMIS with 200,000 blanks in a row."""
    head = "# Units: length:mm angle:deg time:s\n# Stage: 2\nstage;index;relative_time;date\n2;2;0.5;2021\n# Name : surface\n"
    rows = [
        "id;x;y;z;displacement_x;displacement_y;displacement_z",
        "0;1.5;2.0;0.1;0.5;1.0;0.1",
        f"1;2.5;2.0;0.1;0.5;{' ' * 200_000}1.0;0.1",
    ]
    (raw / "given.csv").write_text(head + "\n".join(rows) + "\n", encoding="utf-8")


def camera(raw: Path) -> None:
    """A frame of a camera with 300,000 rows."""
    row = ",".join(f"{300.0 + k / 16.0:.4f}" for k in range(12)) + "\n"
    (raw / "given.csv").write_text("Camera:,A655\nTemperature unit:,K\n" + 300_000 * row, encoding="utf-8")


GIVEN = ("inspect", "RAW/given.csv")
PIPES = ("experiment.yaml", "force.csv", "dic/*", "ir/*")
CASES: dict[str, Case] = {
    "force of 1e300 N in one row": Case(force(lambda n, value: 1e300 if n == 40 else value)),
    "force of 1e300 N in all rows": Case(force(lambda n, value: 1e300)),
    "force 0 throughout": Case(force(lambda n, value: 0.0)),
    "force constant throughout": Case(force(lambda n, value: 1000.0)),
    "force 0 throughout, confirmed": Case(both(force(lambda n, value: 0.0), appended("confirmed: [force]\n"))),
    "force constant throughout, confirmed": Case(both(force(lambda n, value: 1000.0), appended("confirmed: [force]\n"))),
    "all points at one place, confirmed": Case(both(points(at_one_place), appended("confirmed: [place]\n"))),
    "all points at one place": Case(points(at_one_place)),
    "every point forty times": Case(points(lambda rows: [row for row in rows for _ in range(40)])),
    "every point forty times by other numbers": Case(points(forty_times)),
    "tolerance of a fit far too small": Case(keys={"stages": {"elastic": {"tolerance": 1e-300}, "thermal": {"free": ["c0"]}}}),
    "declared noise of the force huge": Case(keys={"force": {"noise": 1e300}}),
    "zero byte in run_dir": Case(words=("run", "STUDY", "--set", 'run_dir="a\\0b"')),
    "home of nobody in run_dir": Case(words=("run", "STUDY", "--set", "run_dir=~nobody-of-that-name/a")),
    "--set with a section that holds itself": Case(words=("run", "STUDY", "--set", "mesh=&a {n_x: *a}")),
    "--set with aliases of aliases": Case(words=("run", "STUDY", "--set", "mesh={" + BOMB.replace("\n", ", ") + "}")),
    "experiment.yaml with aliases of aliases": Case(appended("more:\n" + "".join(f"  {line}\n" for line in BOMB.splitlines()))),
    "study with aliases of aliases": Case(keys={"text": "more:\n" + "".join(f"  {line}\n" for line in BOMB.splitlines())}),
    **{f"a pipe for {name}": Case(instead(name, os.mkfifo)) for name in PIPES},
    "a pipe for a native file": Case(lambda raw: os.mkfifo(raw / "given.csv"), words=GIVEN),
    **{f"/dev/zero for {name}": Case(instead(name, zero)) for name in ("experiment.yaml", "force.csv", "dic/*")},
    "a million lines of experiment.yaml": Case(appended("# a line\n" * 1_000_000)),
    "50 MB of experiment.yaml": Case(appended("note: " + "x" * 50_000_000 + "\n")),
    "two million points in one stage": Case(lambda raw: many(sorted((raw / "dic").iterdir())[2])),
    "200,000 blanks in a text of ARAMIS": Case(aramis, words=GIVEN),
    "300,000 rows in the table of a camera": Case(camera, words=GIVEN),
    "two million nodes asked for": Case(keys={"mesh": {"n_x": 100, "n_y": 1000, "n_z": 20}}),
}


def tried(name: str, case: Case, folder: Path) -> dict[str, object]:
    """One command on one damaged input: how it ended, its CPU time and largest memory."""
    shutil.rmtree(folder / "raw", ignore_errors=True)
    shutil.rmtree(folder / "run", ignore_errors=True)
    shutil.copytree(folder / "whole", folder / "raw")
    keys = dict(case.keys or {})
    more = keys.pop("text", "")
    study = folder / "measured.yaml"
    tree = {**tiny.tree(folder / "run"), "experiment": str(folder / "raw"), **keys}
    del tree["simulate"]
    study.write_text(yaml.safe_dump(tree, sort_keys=False) + more, encoding="utf-8")
    case.damage(folder / "raw")
    words = [word.replace("STUDY", str(study)).replace("RAW", str(folder / "raw")) for word in case.words]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin, said = time.monotonic(), folder / "said"
    with said.open("w", encoding="utf-8") as err:
        process = subprocess.Popen(command(*words), stdout=subprocess.DEVNULL, stderr=err, env=environment(), stdin=subprocess.DEVNULL)
        code, own = waited(process)
    used = resource.getrusage(resource.RUSAGE_CHILDREN) if own is None else own
    cpu = used.ru_utime + used.ru_stime - (before.ru_utime + before.ru_stime if own is None else 0.0)
    text = said.read_text(encoding="utf-8", errors="replace")
    memory = used.ru_maxrss / 1024.0
    wrong = []
    if code not in LAWFUL or "Traceback" in text or "mistake of thermofit" in text:
        wrong.append(f"exit code {code}: {text[-300:]}")
    if code in (2, 3, 4) and text.count("error: ") != 1:
        wrong.append(f"not one sentence: {text[-300:]}")
    if cpu > LIMIT_S or code == -9:
        wrong.append(f"{cpu:.0f} s of CPU, {time.monotonic() - begin:.0f} s in all")
    if memory > LIMIT_MB:
        wrong.append(f"{memory:.0f} MB")
    last = next((line for line in reversed(text.splitlines()) if "error: " in line), "")
    return {"name": name, "code": code, "cpu_s": round(cpu, 1), "MB": round(memory), "said": last[:200], "wrong": "; ".join(wrong)}


def waited(process: subprocess.Popen[bytes]) -> tuple[int, resource.struct_rusage | None]:
    """Exit code and use of a process, which is killed where it waits too long."""
    begin = time.monotonic()
    while time.monotonic() - begin < WAIT_S:
        pid, status, used = os.wait4(process.pid, os.WNOHANG)
        if pid:
            process.returncode = os.waitstatus_to_exitcode(status)
            return process.returncode, used
        time.sleep(0.02)
    process.kill()
    return process.wait(), None


def all_tried(folder: Path) -> Iterator[dict[str, object]]:
    """Every case, on copies of one virtual test."""
    study = small_study(folder)
    tiny.stage_run("simulate")(load_study(study))
    (folder / "run" / "raw").rename(folder / "whole")
    for name, case in CASES.items():
        found = tried(name, case, folder)
        print(f"{name}: {found}", file=sys.stderr, flush=True)
        yield found


def main() -> int:
    """0 where every command ended as it should; words of the command line choose cases that hold one of them."""
    for name in [name for name in CASES if sys.argv[1:] and not any(text in name for text in sys.argv[1:])]:
        del CASES[name]
    with tempfile.TemporaryDirectory(prefix="thermofit-kept-") as name:
        cases = list(all_tried(Path(name)))
    print(json.dumps({"tried": len(cases), "wrong": [one for one in cases if one["wrong"]], "cases": cases}))
    return 1 if any(one["wrong"] for one in cases) else 0


if __name__ == "__main__":
    sys.exit(main())
