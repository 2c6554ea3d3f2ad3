"""Effect files of a user in the slots that change the local update: the same on a bar of finite elements as on a point."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SUPPORT = Path(__file__).resolve().parents[1] / "support"
HEAD = "import numpy as np\nfrom thermofit.core.parameters import Param\nFORMULA = SOURCE = 'made up'\n"
FILES = {
    "my_back": """SLOT = "backstress"
PARAMS = (Param("my_back.C", "MPa", 0.0, 0.0, 1e6, 100.0, "modulus, which falls with flow and temperature", probe=3000.0),)


def backstress(accumulated, rate, theta, law, C):
    return C * (1.0 + 0.5 * np.exp(-30.0 * accumulated)) * (1.0 - 2e-3 * (theta - 297.0)), 40.0 + 100.0 * accumulated
""",
    "my_moduli": """SLOT = "free_energy"
PARAMS = (Param("my_moduli.part", "1", 0.0, 0.0, 0.5, 0.01, "part of the moduli that goes", probe=0.1),)


def free_energy(accumulated, law, part):
    return 1.0 / (1.0 + part * accumulated / (0.03 + accumulated))
""",
    "my_warmth": """SLOT = "elasticity"
PARAMS = (Param("my_warmth.part", "1/K", 0.0, 0.0, 0.05, 1e-3, "part of the moduli that goes per K", probe=5e-3),)


def elasticity(theta, law, part):
    return 1.0 / (1.0 + part * (theta - 280.0))
""",
    "my_sense": """SLOT = "asymmetry"
PARAMS = (Param("my_sense.more", "1", 0.0, -0.5, 0.5, 0.01, "excess in compression", probe=0.05),)


def asymmetry(sense, law, more):
    return 1.0 + more * (1.0 - sense) * (1.0 + 0.3 * sense * sense)
""",
}
ASK = """
from coupons import CYCLES, LOSSY, bar_and_point, corners
from thermofit.core.digest import effect_files
from thermofit.identify.user_effects import check_effects
check_effects(effect_files())
on = {"my_back.C": 2500.0, "my_moduli.part": 0.15, "my_warmth.part": 0.01, "my_sense.more": 0.04, "backstress_first.C": 1500.0}
bar_and_point(LOSSY.replace(**on), *corners(*CYCLES, steps=4), 2, tolerance=1e-10)
bar_and_point(LOSSY.replace(**on, H_lin=500.0), *corners(*CYCLES, steps=4), 2, "force", 1e-10)
print("same")
"""


@pytest.mark.slow
def test_files_of_a_user_act_on_both_drivers(tmp_path: Path) -> None:
    """Four files at once beside one of the catalogue, with a modulus that changes with flow and temperature: to 1e-8."""
    for name, text in FILES.items():
        (tmp_path / f"{name}.py").write_text(HEAD + text)
    files = os.pathsep.join(str(tmp_path / f"{name}.py") for name in FILES)
    paths = os.pathsep.join([str(SUPPORT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "THERMOFIT_EFFECTS": files, "PYTHONPATH": paths}
    ran = subprocess.run([sys.executable, "-c", ASK], capture_output=True, text=True, check=False, env=environment)
    assert ran.returncode == 0 and "same" in ran.stdout, ran.stderr
