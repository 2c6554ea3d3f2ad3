"""Signals at random moments over every command of a small study: what is left is whole, and the same command ends with the same result.

SIGKILL, SIGINT, SIGTERM and SIGUSR1 in turn, at a moment drawn over the time that the command takes. After each: every artefact can be
read to the last value, no process is left, the exit code is 130 (or the command was done before); the same command once more ends with the
values of an undisturbed run, bit for bit, and leaves nothing beside its results.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from reliability_study import command, coupon_study, environment, small_study

from thermofit.core.errors import ThermofitError
from thermofit.records.artefact import open_record

SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)
COMMANDS: tuple[tuple[str, ...], ...] = (
    ("run",),
    ("simulate",),
    ("calibrate-ir",),
    ("interpolate",),
    ("identify-elastic",),
    ("identify-plastic", "--set", "stages.plastic.method=trust-region"),
    ("identify-thermal",),
    ("refine",),
    ("gridsearch", "--jobs", "2"),
    ("sensitivity",),
    ("verify",),
    ("report",),
    ("identifiability", "--bootstrap", "4", "--refit"),
    ("diagnose",),
    ("close-loop", "--max-effects", "1"),
)
ON_COUPONS = ("close-loop",)
"""Commands on a study of a coupon: on a body they take minutes."""
TIMES_OUT_S = 600.0
TIMES = {"log", "facts", "wall_s"}
"""Parts of names of datasets that tell of time."""
PARAMETER = "parameter "
"""Before the names of parameters, whose values stand as text: (value, standard error)."""
LAWFUL = {signal.SIGKILL: {-signal.SIGKILL}, signal.SIGINT: {130}, signal.SIGTERM: {130}, signal.SIGUSR1: {130}}


@dataclass(frozen=True)
class Fault:
    """One signal: which command, when (s after its start), whether the command still ran then, and what was wrong afterwards; empty where
    all was well."""

    command: str
    signal: str
    moment_s: float
    met: bool
    code: int
    wrong: str


def values_of(run_dir: Path, stage: str) -> dict[str, bytes]:
    """Every dataset and parameter of an artefact, but what tells of time and of work that was not repeated."""
    record = open_record(run_dir / f"{stage}.h5")
    found = {f"{PARAMETER}{name}": repr((p.value, p.sigma)).encode() for name, p in record.parameters.items()}
    for name in record.names:
        value = record[name].value
        if not name.startswith("evaluations/") and not set(name.split("/")) & TIMES:
            found[name] = repr(value.tolist()).encode() if value.dtype.kind in "UO" else np.ascontiguousarray(value).tobytes()
    return found


def stage_of(name: str) -> str:
    """The artefact that shows the result of a command."""
    return "verify" if name == "run" else name


def damaged(run_dir: Path) -> str:
    """The first artefact that cannot be read whole; empty where there is none."""
    for path in sorted(run_dir.glob("*.h5")):
        try:
            record = open_record(path)
            for name in record.names:
                record[name]
        except ThermofitError as error:
            return str(error)
    return ""


def left_behind(run_dir: Path) -> str:
    """What lies in a run folder beside results."""
    return ", ".join(str(path.relative_to(run_dir)) for path in run_dir.rglob("*") if path.name.startswith("."))


def signalled(folder: Path, study: Path, words: Sequence[str], number: signal.Signals, moment: float, whole: dict[str, bytes]) -> Fault:
    """One signal at a moment, and everything that is looked at afterwards."""
    run_dir, name = folder / "run", " ".join(words)
    arguments = command(words[0], str(study), *words[1:], "--force")
    with subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment()) as process:
        met = False
        try:
            process.wait(timeout=moment)
        except subprocess.TimeoutExpired:
            met = True
            process.send_signal(number)
        try:
            said = process.communicate(timeout=TIMES_OUT_S)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            return Fault(name, number.name, moment, met, -999, f"it did not end within {TIMES_OUT_S:g} s")
    code = process.returncode
    wrong = []
    if code not in LAWFUL[number] | {0, 5}:
        wrong.append(f"exit code {code}: {said[-300:]}")
    if "Traceback" in said or (code == 130 and said.count("error: ") != 1):
        wrong.append(f"more than a sentence: {said[-300:]}")
    if text := damaged(run_dir):
        wrong.append(text)
    done = subprocess.run(arguments[:-1] if code == 0 else arguments, capture_output=True, text=True, env=environment(), check=False)
    if done.returncode not in (0, 5):
        wrong.append(f"the same command ends with {done.returncode}: {done.stderr[-300:]}")
    elif different := [key for key, value in values_of(run_dir, stage_of(words[0])).items() if whole.get(key) != value]:
        wrong.append(f"other values of {', '.join(different[:4])}")
    if text := left_behind(run_dir):
        wrong.append(f"left behind: {text}")
    return Fault(name, number.name, moment, met, code, "; ".join(wrong))


def main() -> int:
    """0 where every fault was survived."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--number", type=int, default=50, help="signals in all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", default=[], help="commands")
    options = parser.parse_args()
    draw = random.Random(options.seed)
    chosen = [words for words in COMMANDS if not options.only or words[0] in options.only]
    faults = []
    with tempfile.TemporaryDirectory(prefix="thermofit-signals-") as name:
        of_body, of_coupon = Path(name) / "body", Path(name) / "coupon"
        of_body.mkdir()
        of_coupon.mkdir()
        body, coupon = small_study(of_body), coupon_study(of_coupon)
        if any(words[0] not in ON_COUPONS for words in chosen):
            subprocess.run(command("run", str(body), "--all"), capture_output=True, env=environment(), check=True)
        for k, words in enumerate(chosen):
            folder, study = (of_coupon, coupon) if words[0] in ON_COUPONS else (of_body, body)
            begin = time.monotonic()
            undisturbed = command(words[0], str(study), *words[1:], "--force")
            done = subprocess.run(undisturbed, capture_output=True, text=True, env=environment(), check=False)
            if done.returncode not in (0, 5):
                raise SystemExit(f"'{' '.join(words)}' ends with {done.returncode} where nothing disturbs it: {done.stderr[-1000:]}")
            whole, took = values_of(folder / "run", stage_of(words[0])), time.monotonic() - begin
            shutil.copytree(folder / "run", folder / "whole", dirs_exist_ok=True)
            for number in range(k, options.number, len(chosen)):
                one = signalled(folder, study, words, SIGNALS[(number // len(chosen) + k) % 4], draw.uniform(0.02, took), whole)
                faults.append(one)
                print(f"{one.command:20s} {one.signal:8s} {one.moment_s:6.2f} s  {one.wrong or 'survived'}", file=sys.stderr, flush=True)
                if one.wrong:  # the next one begins with a sound folder
                    shutil.rmtree(folder / "run")
                    shutil.copytree(folder / "whole", folder / "run")
    # A command that had ended before its signal has met none; what is wrong after it counts all the same.
    met = [one for one in faults if one.met]
    survived = sum(not one.wrong for one in met)
    of = {" ".join(words): [one for one in met if one.command == " ".join(words)] for words in chosen}
    commands = {name: [len(some), sum(not one.wrong for one in some)] for name, some in of.items()}
    wrong = [vars(one) for one in faults if one.wrong]
    print(json.dumps({"injected": len(met), "survived": survived, "commands": commands, "wrong": wrong}))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
