"""Pictures of the README and the site, from the run of docs/tutorial.md: its report, and its residual maps before and after.

python scripts/doc_pictures.py RUN_DIR
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

import thermofit

matplotlib.use("Agg")
import matplotlib.pyplot as plt

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "pictures"
WIDTH, HEIGHT = 1280, 1010
"""Of the part of the report that is shown, in pixels."""


def maps(run: Path) -> Path:
    """Residual of the temperature rise over the observed face at the last frame, without and with the effect that the loop added."""
    record = thermofit.open_run(run).record("close-loop")
    time, xy = record["residual/time"].value, record["residual/xy"].value
    rows = record["residual/channel"].value == [str(name) for name in record["rms/channel"].value].index("dtheta")
    rows &= time == time[rows].max()
    figure, axes = plt.subplots(1, 2, figsize=(4.6, 4.2), sharey=True, layout="constrained")
    for ax, (name, title) in zip(axes, (("before", "base model"), ("value", "with the effect")), strict=True):
        residual = record[f"residual/{name}"].value[rows]
        shown = ax.tripcolor(*xy[rows].T, residual, cmap="RdBu_r", vmin=-6.0, vmax=6.0)
        ax.set(title=f"{title}\nrms {np.sqrt(np.mean(residual**2)):.2f} x noise", xlabel="x in mm", aspect="equal")
    axes[0].set_ylabel("y in mm")
    figure.colorbar(shown, ax=axes, label="temperature residual over noise", shrink=0.8)
    figure.savefig(path := FOLDER / "before-after.png", dpi=100)
    return path


def report(run: Path) -> Path:
    """The first page of the report, as Chromium shows it."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        raise SystemExit("no chromium found: install it to draw the page")
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "report.png"
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--window-size={WIDTH},{HEIGHT}"]
        subprocess.run(
            [browser, *options, f"--screenshot={shot}", (run / "report.html").absolute().as_uri()], check=True, capture_output=True
        )
        # So many colours are enough for a page of text, bars and one map.
        Image.open(shot).convert("RGB").quantize(192).save(path := FOLDER / "report.png", optimize=True)
    return path


if __name__ == "__main__":
    for draw in (maps, report):
        print(draw(Path(sys.argv[1])))
