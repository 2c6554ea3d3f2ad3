"""Everything that says whether thermofit keeps working, in one unattended run, and the page of it: docs/reliability.md.

Parts run in processes of their own, as many side by side as --jobs says. What a part has answered is kept in runs/reliability by the digest
of the package, its own tests or scripts and their helpers, so that a run that was stopped resumes, and the page is written from what is
there after every part.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mutations import LIST, digest, sources, with_helpers

from thermofit.core.files import replacing

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "runs" / "reliability"
PAGE = ROOT / "docs" / "reliability.md"
EVERY = ("-m", "slow or not slow", "-o", "junit_family=xunit1")
"""All tests; the older form of reports alone holds figures."""
Answer = Mapping[str, Any]


@dataclass(frozen=True)
class Part:
    """A script that prints JSON, or tests whose properties are read; `title` heads its section."""

    name: str
    title: str
    script: tuple[str, ...] = ()
    tests: tuple[str, ...] = ()
    drawn: bool = False
    """True where the tests draw their inputs (hypothesis), which are counted."""
    alone: bool = False
    """True where it uses all cores itself."""


BODY = ("manufactured", "benchmarks", "heat", "first_law", "reference", "objectivity", "limit")
FAULTS = ("faults", "kill", "search_kill")
DRAWN = ("formats", "test_raw.py", "test_plausible.py", "test_coupon.py")
PARTS = (
    Part("numerics", "Code verification", tests=(*(f"tests/body/test_{n}.py" for n in BODY), "tests/point/test_point_reference.py")),
    Part("solution", "Solution verification", tests=("tests/experiment/test_refinement.py", "tests/experiment/test_discretisation.py")),
    Part("inputs", "Mutated inputs", script=("reliability_inputs.py", "--number", "2000")),
    Part("drawn", "Drawn inputs", tests=tuple(f"tests/read/{n}" for n in DRAWN), drawn=True),
    Part("kept", "Inputs that once did harm", script=("reliability_kept.py",)),
    Part("hostile", "Hostile files", tests=("tests/read/test_hostile_files.py", "tests/stages/test_bad_input.py")),
    Part(
        "faults",
        "Faults",
        tests=(*(f"tests/stages/test_{n}.py" for n in FAULTS), "tests/records/test_lock.py", "tests/records/test_executor.py"),
    ),
    Part("signals", "Signals at random moments", script=("reliability_signals.py", "--number", "60")),
    Part("same", "The same answer", script=("reliability_same.py", "--caches")),
    Part("large", "Long and large", script=("reliability_large.py",)),
    Part("mutations", "Mutations of the code", script=("mutations.py", "--json", "--jobs", "2"), alone=True),
)


def state(part: Part) -> str:
    """What the answer of a part depends on, in short."""
    of_scripts = [
        ROOT / "scripts" / "bench_interpolation.py",
        *(ROOT / "scripts").glob("reliability_*.py"),
        *(ROOT / "tests/support").glob("*.py"),
    ]
    files = (
        with_helpers(ROOT, part.tests) if part.tests else [LIST, ROOT / "scripts" / "mutations.py"] if part.alone else sorted(of_scripts)
    )
    own = digest(*(path.read_text(encoding="utf-8") for path in files), *part.script)
    return f"{sources(ROOT, 'thermofit', *(['tests'] if part.alone else []))}-{own}"


def tested(part: Part) -> Answer:
    """Counts of the tests of a part, and the figures that they tell (`record_property`)."""
    report = KEPT / f"{part.name}.xml"
    words = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-n",
        "0",
        "-p",
        "no:cacheprovider",
        *EVERY,
        *(("--hypothesis-show-statistics",) if part.drawn else ()),
        f"--junitxml={report}",
        *part.tests,
    ]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    if not report.exists():
        return {"code": done.returncode, "error": (done.stdout + done.stderr)[-500:]}
    cases = list(ElementTree.parse(report).iter("testcase"))
    bad = [f"{c.get('classname')}.{c.get('name')}" for c in cases if c.find("failure") is not None or c.find("error") is not None]
    figures = {p.get("name"): p.get("value") for case in cases for p in case.iter("property")}
    if part.drawn:
        counts = [[int(n) for n in found] for found in re.findall(r"(\d+) passing, (\d+) failing, and (\d+) invalid", done.stdout)]
        passing, failing, invalid = (sum(some) for some in zip(*counts, strict=True))
        figures |= {"inputs drawn and judged": passing + failing, "of them failed (0)": failing, "drawn and not judged": invalid}
    skipped = sum(case.find("skipped") is not None for case in cases)
    return {"code": done.returncode, "tests": len(cases), "failed": bad, "skipped": skipped, "figures": figures}


def scripted(part: Part) -> Answer:
    """What a script prints as JSON, and its exit code; what it says meanwhile is in its log."""
    name, *more = part.script
    words = [sys.executable, str(ROOT / "scripts" / name), *more]
    log = KEPT / f"{part.name}.log"
    with log.open("w", encoding="utf-8") as said:
        done = subprocess.run(words, cwd=ROOT, stdout=subprocess.PIPE, stderr=said, text=True, check=False)
    try:
        return {"code": done.returncode, **json.loads(done.stdout)}
    except json.JSONDecodeError:
        return {"code": done.returncode, "error": (done.stdout + log.read_text(encoding="utf-8"))[-500:]}


def last(part: Part) -> Answer | None:
    """The answer of the last run, of whatever sources; None where there is none."""
    path = KEPT / f"{part.name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def kept(part: Part) -> Answer | None:
    """The answer of an earlier run, None where there is none of these sources."""
    found = last(part)
    return found if found is not None and found["state"] == state(part) else None


def ran(part: Part) -> None:
    """Run a part and keep its answer."""
    begin, now = time.perf_counter(), state(part)
    answer = tested(part) if part.tests else scripted(part)
    with replacing(KEPT / f"{part.name}.json") as partial:
        whole = {"state": now, "seconds": round(time.perf_counter() - begin, 1), **answer}
        partial.write_text(json.dumps(whole), encoding="utf-8")
    print(f"{part.name:10s} {whole['seconds']:8.1f} s  {'good' if answer['code'] == 0 else 'NOT GOOD'}", file=sys.stderr, flush=True)


def rows(part: Part, found: Answer) -> list[str]:
    """Lines of the page on one part."""
    if "error" in found:
        return [f"Not finished: `{' '.join(str(found['error']).split())[-300:]}`"]
    if part.tests:
        lines = [f"{found['tests']} tests, {len(found['failed'])} failed, {found['skipped']} skipped."]
        lines += [f"* failed: `{name}`" for name in found["failed"]]
        return [*lines, "", *table(("figure", "found"), found["figures"].items())] if found["figures"] else lines
    return OF_SCRIPTS[part.name](found)


def table(head: Sequence[str], body: Any) -> list[str]:
    """A table of the page."""
    return ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *("| " + " | ".join(map(str, row)) + " |" for row in body)]


def _inputs(found: Answer) -> list[str]:
    keys = ("inputs", "refused", "accepted", "internal", "slow", "largest_memory_MB")
    head = ("tried", "refused in a sentence", "accepted", "internal errors (0)", "over 20 s (0)", "largest memory, MB (< 2048)")
    return [*table(head, [[found[k] for k in keys]]), *(f"* {one}" for one in found["bad"])]


def _kept(found: Answer) -> list[str]:
    refused = sum(one["code"] != 0 for one in found["cases"])
    most_s, most_mb = (max(one[key] for one in found["cases"]) for key in ("cpu_s", "MB"))
    said = f"{found['tried']} commands: {refused} refused in a sentence, {found['tried'] - refused} accepted, {len(found['wrong'])} wrong."
    body = [(one["name"], one["code"], one["cpu_s"], one["MB"]) for one in found["cases"]]
    lines = [
        f"{said} At most {most_s} s of CPU (20) and {most_mb} MB (2048).",
        "",
        *table(("input", "exit code", "CPU s", "MB at most"), body),
    ]
    return [*lines, *(f"* {one['name']}: {one['wrong'][:300]}" for one in found["wrong"])]


def _signals(found: Answer) -> list[str]:
    wrong = [f"* {one['command']} {one['signal']} at {one['moment_s']:.2f} s: {one['wrong'][:200]}" for one in found["wrong"]]
    table_of = table(("command", "signals", "survived"), [(name, *counts) for name, counts in found["commands"].items()])
    said = f"{found['injected']} signals (SIGKILL, SIGINT, SIGTERM, SIGUSR1) while a command ran, {found['survived']} survived."
    return [said, "", *table_of, *(["", *wrong] if wrong else [])]


def _same(found: Answer) -> list[str]:
    each = {k: v for k, v in found.items() if isinstance(v, dict)}
    body = [(k, v["compared"], v["differing"], f"{v['largest_relative']:.1e}", v["where"]) for k, v in each.items()]
    lines = table(("compared", "values", "differing", "largest relative difference of a dataset", "of"), body)
    if "parameters" not in found:
        return lines
    return [*lines, "", f"Identified parameters with BLAS kernels of another processor: {found['parameters']:.1e} apart at most (1e-8)."]


def _large(found: Answer) -> list[str]:
    fits = found["fits"]
    lines = [
        f"{fits['identifications']} identifications in one process: {fits['early_MB']} MB after a tenth, {fits['late_MB']} MB at the end, "
        f"{fits['growth_percent']} % more (limit 5 %), {fits['s']} s."
    ]
    lines += ["", f"Fields: {found['fields']}", "", f"Frames: {found['frames']}", ""]
    head = ("elements", "degrees of freedom", "steps", "CPU s", "peak MB")
    keys = ("elements", "degrees_of_freedom", "steps", "cpu_s", "peak_MB")
    lines += ["Memory and time by size, of a coupled run on a shortened programme of so many steps:", ""]
    return [*lines, *table(head, [[row.get(k, row.get("error", "")) for k in keys] for row in found["meshes"]])]


def _mutations(found: Answer) -> list[str]:
    body = [(room, one["all"], one["noticed"]) for room, one in found["rooms"].items()]
    missed = [one["name"] for one in found["answers"] if not one["noticed"]]
    of_rules = found["rooms"].get("diagnose", {"noticed": 0, "all": 0})
    share = 100.0 * of_rules["noticed"] / max(of_rules["all"], 1)
    return [
        f"{100.0 * found['noticed']:.1f} % of {len(found['answers'])} noticed (95 %), of the diagnosis {share:.1f} % (90 %).",
        f"{found['earlier']} of them were judged on earlier sources: since then neither the mutated file nor its tests have changed.",
        "",
        *table(("room", "tried", "noticed"), body),
        "",
        f"Not noticed: {', '.join(missed) or 'none'}",
    ]


OF_SCRIPTS = {"inputs": _inputs, "kept": _kept, "signals": _signals, "same": _same, "large": _large, "mutations": _mutations}


def page() -> str:
    """The page of all parts, those that have not run, or not on these sources, marked."""
    lines = [
        "# Reliability",
        "",
        "Written by `make reliability`, which runs what stands below unattended and resumes where it was stopped. Times are those of the",
        f"machine that ran it: {os.cpu_count()} cores, {datetime.now(UTC):%Y-%m-%d}.",
        "What each part does stands at the head of its script or test.",
    ]
    for part in PARTS:
        found = last(part)
        lines += ["", f"## {part.title}", ""]
        source = f"`scripts/{part.script[0]}`" if part.script else ", ".join(f"`{name}`" for name in part.tests)
        if found is None:
            lines.append(f"Not run ({source}).")
        else:
            lines += ["Of earlier sources.", ""] if found["state"] != state(part) else []
            lines += [*rows(part, found), "", f"{source}: {found['seconds']:.0f} s"]
    return "\n".join(lines) + "\n"


def main() -> int:
    """0 where every part is good."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", default=[], choices=[part.name for part in PARTS])
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--force", action="store_true", help="run again what is known")
    parser.add_argument("--page", action="store_true", help="write the page of what is there and run nothing")
    options = parser.parse_args()
    KEPT.mkdir(parents=True, exist_ok=True)
    chosen = [part for part in PARTS if not options.only or part.name in options.only]
    todo = [] if options.page else [part for part in chosen if options.force or kept(part) is None]
    begin = time.perf_counter()
    for group, jobs in (([p for p in todo if not p.alone], options.jobs), ([p for p in todo if p.alone], 1)):
        with ThreadPoolExecutor(jobs) as pool:
            for future in [pool.submit(ran, part) for part in group]:
                future.result()
                PAGE.write_text(page(), encoding="utf-8")
    PAGE.write_text(page(), encoding="utf-8")
    print(f"{PAGE}: {time.perf_counter() - begin:.0f} s", file=sys.stderr)
    return 0 if all((found := kept(part)) is not None and found["code"] == 0 for part in chosen) else 1


if __name__ == "__main__":
    sys.exit(main())
