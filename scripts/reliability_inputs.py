"""Mutated inputs through the readers and the loader of studies: each has to end in content or in one sentence, soon and in little memory.

Seeds are the files of a small virtual experiment, its study, and small native exports (tests/support/samples). Every input is one to five
damages of a seed (tests/support/fuzz), drawn from a fixed seed of random numbers, so that a bad one can be made again by its number.
"""

from __future__ import annotations

import argparse
import json
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from reliability_study import fuzz, small_study, tiny

from thermofit.core.errors import ThermofitError
from thermofit.read.raw import read_experiment
from thermofit.stages.inspect import inspect
from thermofit.study.study import load_study

LIMIT_S = 20.0
LIMIT_MB = 2048.0
FORMATS = Path(__file__).resolve().parent.parent / "tests" / "read" / "formats"


@contextmanager
def limited() -> Iterator[None]:
    """TimeoutError after LIMIT_S of work."""

    def over(number: int, frame: FrameType | None) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def outcome(call: Callable[[], object]) -> tuple[str, str]:
    """accepted, refused, internal or slow; and what was said."""
    try:
        with limited():
            call()
        return "accepted", ""
    except ThermofitError as error:
        return ("refused" if "\n" not in str(error) else "internal"), str(error)
    except TimeoutError:
        return "slow", f"more than {LIMIT_S:g} s"
    except Exception as error:
        return "internal", f"{type(error).__name__}: {error}"


def main() -> int:
    """0 where there is no internal error and nothing is slow or large."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--number", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    counts = dict.fromkeys(("accepted", "refused", "internal", "slow"), 0)
    bad = []
    with tempfile.TemporaryDirectory(prefix="thermofit-inputs-") as name:
        folder = Path(name)
        study = small_study(folder)
        tiny.stage_run("simulate")(load_study(study))
        raw = folder / "run" / "raw"
        seeds = [
            raw / "experiment.yaml",
            raw / "force.csv",
            *sorted((raw / "dic").iterdir())[:2],
            *sorted((raw / "ir").iterdir())[:1],
            study,
        ]
        text = study.read_bytes()
        for k in range(options.number):
            draw = random.Random(options.seed * 1_000_003 + k)
            seed = draw.choice(seeds)
            whole = seed.read_bytes()
            steps = [(draw.randrange(len(fuzz.MUTATIONS)), draw.randrange(2**32)) for _ in range(draw.randint(1, 5))]
            seed.write_bytes(fuzz.mutate(whole, steps))
            begin = time.perf_counter()
            if seed == study:
                kind, said = outcome(lambda: load_study(study))
            elif draw.random() < 0.5:
                kind, said = outcome(lambda: read_experiment(raw))
            else:
                kind, said = outcome(lambda path=seed: inspect(path))  # type: ignore[misc]
            counts[kind] += 1
            if kind in ("internal", "slow"):
                bad.append({"number": k, "file": seed.name, "kind": kind, "said": said[:300], "s": round(time.perf_counter() - begin, 1)})
                print(bad[-1], file=sys.stderr, flush=True)
            seed.write_bytes(whole)
            study.write_bytes(text)
        shutil.rmtree(raw)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(json.dumps({"inputs": options.number, **counts, "largest_memory_MB": round(memory), "bad": bad}))
    return 0 if not bad and memory < LIMIT_MB else 1


if __name__ == "__main__":
    sys.exit(main())
