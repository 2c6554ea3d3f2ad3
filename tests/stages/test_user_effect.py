"""docs/effects.md followed literally: a user's effect file takes part like the built-in ones."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import tiny
import yaml

from thermofit.effects.catalogue import FILE_SLOTS, MATERIAL
from thermofit.identify.user_effects import trial_of

PAGE = Path(__file__).resolve().parents[2] / "docs" / "effects.md"

_ASK = """
import json, sys
import numpy as np
from thermofit.study.study import load_study
study = load_study(sys.argv[1])
from thermofit.core.parameters import Parameters, known_names
from thermofit.effects.catalogue import effects
from thermofit.law.page import flow_stress, law_of, yield_stress
base = Parameters.of({"theta_ref": 297.0})
off, on = law_of(base), law_of(base.replace(**{"my_softening.rate": 0.2}))
print(json.dumps({
    "known": "my_softening.rate" in known_names(),
    "slot": [e.slot for e in effects() if e.name == "my_softening"],
    "off": [flow_stress.py_func(0.03, 0.1, 0.01, 297.0, off)[0], yield_stress.py_func(0.03, 0.1, off)[0]],
    "on": flow_stress.py_func(0.03, 0.1, 0.01, 297.0, on)[0],
}))
"""


def written(folder: Path) -> Path:
    """The effect file and the study of the page, as they stand there."""
    text = PAGE.read_text(encoding="utf-8")
    name = re.search(r"Save this as `([a-z_]+\.py)`", text)
    code = re.search(r"```python\n(.*?)```", text, re.S)
    lines = re.findall(r"```yaml\n(.*?)```", text, re.S)
    assert name is not None and code is not None and len(lines) == 2
    (folder / name.group(1)).write_text(code.group(1), encoding="utf-8")
    study = folder / "study.yaml"
    content = {**tiny.tree(folder / "run"), "simulate": tiny.tree(folder / "run").get("simulate"), **yaml.safe_load(lines[0])}
    study.write_text(yaml.safe_dump(content), encoding="utf-8")
    return study


def python(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k != "THERMOFIT_EFFECTS"}
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, env=environment)


def test_the_page_is_right(tmp_path: Path) -> None:
    """The effect is known, dormant, and changes the yield stress as its formula says."""
    ran = python("-c", _ASK, str(written(tmp_path)))
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert found["known"] and found["slot"] == ["yield_factor"]
    assert found["off"][0] == found["off"][1]
    assert found["on"] == pytest.approx(found["off"][0] * (1.0 - 0.2 * 0.1), rel=1e-12)


def test_every_slot_stands_on_the_page_with_its_arguments() -> None:
    """Those that a file may use and no other; arguments as many as a trial of the slot has."""
    section = PAGE.read_text(encoding="utf-8").partition("## Slots")[2]
    rows = [line.split("|")[1:3] for line in section.splitlines() if line.startswith("| `")]
    told, last = {}, 0
    for names, function in rows:
        last = function.count(",") if "(" in function else last
        told |= dict.fromkeys(re.findall(r"`(\w+)`", names), last)
    assert sorted(told) == sorted(FILE_SLOTS) and "`ON`" in section
    of_law = {**dict.fromkeys(MATERIAL, 4), "free_energy": 2, "elasticity": 2, "asymmetry": 2}
    assert told == {slot: of_law.get(slot) or len(trial_of(slot).arguments) for slot in FILE_SLOTS}


_DIGESTS = """
import json, sys
from thermofit.study.study import load_study
load_study(sys.argv[1])
from thermofit.core.digest import source_digest
from thermofit.core.jit import CACHE_FOLDER
print(json.dumps([source_digest(), str(CACHE_FOLDER)]))
"""


def test_an_edited_file_is_another_source_with_kernels_of_its_own(tmp_path: Path) -> None:
    """Through the study, in three processes: artefacts made before the edit are stale, and no kernel of theirs is taken."""
    study, file, seen = written(tmp_path), tmp_path / "my_softening.py", []
    text = file.read_text(encoding="utf-8")
    for content in (text, text.replace("1.0 - rate * accumulated", "1.0 - 2.0 * rate * accumulated"), text):
        file.write_text(content, encoding="utf-8")
        ran = python("-c", _DIGESTS, str(study))
        assert ran.returncode == 0, ran.stderr
        seen.append(json.loads(ran.stdout))
    first, edited, again = seen
    assert first == again and first[0] != edited[0] and first[1] != edited[1]


_READ_FIRST = """
import sys
from thermofit.cli import main
try:
    main()
except SystemExit as end:
    print(end.code, "thermofit.law.composition" in sys.modules)
"""


@pytest.mark.parametrize("command", ["run", "simulate", "verify", "diagnose", "close-loop", "identifiability"])
def test_a_command_reads_its_study_before_it_loads_kernels(tmp_path: Path, command: str) -> None:
    """Else a user's effects come too late: asked of a study that is not there."""
    ran = python("-c", _READ_FIRST, command, str(tmp_path / "none.yaml"))
    assert ran.stdout.split()[-2:] == ["2", "False"], ran.stderr


@pytest.mark.slow
def test_the_users_effect_is_a_candidate_of_the_diagnosis(tmp_path: Path) -> None:
    study = written(tmp_path)
    for command in (["run", str(study), "--until", "verify"], ["diagnose", str(study), "--json"]):
        ran = python("-c", "from thermofit.cli import main; main()", *command)
        assert ran.returncode in (0, 5), ran.stderr
    assert "my_softening" in [row["effect"] for row in json.loads(ran.stdout)["ranking"]]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("PARAMS = 1\n", "SLOT is missing"),
        ("SLOT = 'nowhere'\nPARAMS = ()\nFORMULA = SOURCE = ''\n", "expected one of"),
        ("SLOT = 'base'\nPARAMS = ()\nFORMULA = SOURCE = ''\n", "SLOT is 'base'; expected one of"),
        ("SLOT = 'yield_factor'\nPARAMS = (1,)\nFORMULA = SOURCE = ''\n", "expected Param"),
        ("def broken(:\n", "does not run"),
    ],
)
def test_what_is_wrong_with_an_effect_file_is_said(tmp_path: Path, text: str, said: str) -> None:
    study = written(tmp_path)
    (tmp_path / "my_softening.py").write_text(text, encoding="utf-8")
    ran = python("-c", "from thermofit.cli import main; main()", "diagnose", str(study))
    assert ran.returncode == 2 and said in ran.stderr and "my_softening.py" in ran.stderr and "Traceback" not in ran.stderr, ran.stderr


@pytest.mark.parametrize("body", ["1.0 if accumulated > 0.1 else 0.5", "1.0 - rate * unknown_name", "1.0 - rate * float(str(accumulated))"])
def test_an_effect_that_does_not_compile_is_said_before_anything_runs(tmp_path: Path, body: str) -> None:
    """A file that Python takes and numba, or complex numbers, do not: one sentence, exit 2."""
    study = written(tmp_path)
    file = tmp_path / "my_softening.py"
    file.write_text(file.read_text(encoding="utf-8").replace("1.0 - rate * accumulated", body), encoding="utf-8")
    ran = python("-c", "from thermofit.cli import main; main()", "diagnose", str(study))
    assert ran.returncode == 2 and "does not compile" in ran.stderr and "my_softening.py" in ran.stderr, ran.stderr
    assert "Traceback" not in ran.stderr and len(ran.stderr.splitlines()) < 8


def test_a_fault_outside_the_law_is_said_before_anything_runs(tmp_path: Path) -> None:
    """A wrong attribute in the measuring chain is a mistake of the file, not of thermofit."""
    study = written(tmp_path)
    (tmp_path / "my_softening.py").write_text(
        "from thermofit.core.parameters import Param\n"
        "SLOT, FORMULA, SOURCE = 'sensor', 'made up', 'made up'\n"
        "PARAMS = (Param('my_softening.rate', 'K', 0.0, -5.0, 5.0, 0.1, 'shift', probe=0.5),)\n"
        "def sensor(theta, scene, rate):\n    return theta + rate * scene.strains\n",
        encoding="utf-8",
    )
    ran = python("-c", "from thermofit.cli import main; main()", "diagnose", str(study))
    assert ran.returncode == 2 and "function 'sensor' does not run (AttributeError" in ran.stderr and "my_softening.py" in ran.stderr, (
        ran.stderr
    )
    assert "mistake of thermofit" not in ran.stderr and not (tmp_path / "run").exists()


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    study = written(tmp_path)
    (tmp_path / "my_softening.py").unlink()
    ran = python("-c", "from thermofit.cli import main; main()", "diagnose", str(study))
    assert ran.returncode == 2 and "my_softening.py" in ran.stderr
