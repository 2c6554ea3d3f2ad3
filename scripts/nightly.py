"""All tests, the slow ones too, and a page of what failed and what took long: runs/nightly.md."""

from __future__ import annotations

import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
REPORT, PAGE = ROOT / "runs" / "nightly.xml", ROOT / "runs" / "nightly.md"
LONGEST = 30


def main() -> int:
    """The exit code of pytest; its arguments are passed on, such as -n 2."""
    REPORT.parent.mkdir(exist_ok=True)
    REPORT.unlink(missing_ok=True)
    begin = time.perf_counter()
    words = [sys.executable, "-m", "pytest", "-q", "-m", "slow or not slow", f"--junitxml={REPORT}", *sys.argv[1:]]
    code = subprocess.run(words, cwd=ROOT, check=False).returncode
    if not REPORT.exists():
        print("error: pytest has left no results", file=sys.stderr)
        return code or 1
    kinds: Counter[str] = Counter()
    rows = []
    for case in ElementTree.parse(REPORT).iter("testcase"):
        kind = next((k for k in ("failure", "error", "skipped") if case.find(k) is not None), "passed")
        kinds[kind] += 1
        rows.append((float(case.get("time") or 0.0), kind, f"{case.get('classname')}.{case.get('name')}"))
    bad = [name for _, kind, name in rows if kind in ("failure", "error")]
    lines = [f"# All tests, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC", "", f"{dict(kinds)} in {time.perf_counter() - begin:.0f} s", ""]
    lines += [*(f"* failed: `{name}`" for name in bad), "", "| s | test |", "|---|---|"]
    lines += [f"| {seconds:.0f} | `{name}` |" for seconds, _, name in sorted(rows, reverse=True)[:LONGEST]]
    PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{PAGE}: {len(bad)} failed", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
