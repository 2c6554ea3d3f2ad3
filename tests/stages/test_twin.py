"""Twin tests: a virtual experiment goes through the instruments and the whole chain, and its truth must come back."""

from __future__ import annotations

from pathlib import Path

import pytest
import tiny

from thermofit.records.artefact import Record
from thermofit.study.study import Study, load_study

CONFIGS = Path(__file__).parents[2] / "configs"
WELL_DETERMINED = ("E", "nu", "M_y0", "M_yinf", "H_exp", "F", "alpha_exp", "c0", "beta")
WEAKLY_DETERMINED = ("kappa", "alpha_air", "alpha_clamp")
CHAIN = ("simulate", "calibrate-ir", "interpolate", "identify-elastic", "identify-plastic", "identify-thermal")


@pytest.fixture(scope="module")
def loose_machine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Study of an elastic test in a machine that gives a little and whose jaws slip by hundredths of a millimetre; full noise."""
    folder = tmp_path_factory.mktemp("loose")
    content = tiny.tree(folder / "run")
    content["simulate"] |= {
        "programme": [{"hold": 3.0}, {"crosshead_to": 0.6, "rate": 0.14}],
        "machine": {"compliance": 1.0e-5, "slip": 0.03, "rotation_deg": 0.02},
    }
    # A yield limit that the test does not reach.
    content["simulate"]["truth"] |= {"M_y0": 250.0, "M_yinf": 400.0}
    return tiny.write(folder, content)


def elastic(study_file: Path, channel: str) -> Record:
    """The elastic stage with one displacement channel, up to the end of the test."""
    study = load_study(
        study_file, [f"stages.elastic.channels={{{channel}: {{}}}}", "stages.elastic.window=all", f"run_dir={study_file.parent}/run"]
    )
    for name in ("simulate", "calibrate-ir", "interpolate"):
        tiny.stage_run(name)(study)
    return tiny.stage_run("identify-elastic")(study).record


def test_relative_displacements_see_through_the_machine(loose_machine: Path) -> None:
    """Table 5.2: with u the compliance of the machine and the slip of the jaws make E too small; with du they cannot be seen."""
    du, u = elastic(loose_machine, "du"), elastic(loose_machine, "u")
    truth = tiny.TRUTH["E"]
    assert du.parameters["E"].value == pytest.approx(truth, rel=0.01)
    assert 0.7 * truth < u.parameters["E"].value < 0.95 * truth and not u.parameters["E"].at_bound
    # Rigid-body motion is no elastic field: what u leaves over is far above the noise, what du leaves over is the noise.
    assert du.summary["channels"]["du"]["chi2_reduced"] == pytest.approx(1.0, abs=0.1)
    assert u.summary["channels"]["u"]["chi2_reduced"] > 5.0


def identified(study: Study) -> dict[str, tuple[float, float]]:
    """Value and standard error of everything that the chain identifies."""
    found: dict[str, tuple[float, float]] = {}
    for name in CHAIN:
        record = tiny.stage_run(name)(study).record
        found |= {key: (p.value, p.sigma or 0.0) for key, p in record.parameters.items() if p.free}
    return found


@pytest.mark.slow
@pytest.mark.parametrize("mesh", ["coarse", "full"])
def test_experiment_3_comes_back(tmp_path: Path, mesh: str) -> None:
    """All twelve parameters of the thesis's experiment 3 from raw files with full noise, on another mesh than that of the truth."""
    study = load_study(CONFIGS / "exp3.yaml", [f"mesh={mesh}", f"run_dir={tmp_path}/run"])
    assert study.simulate is not None
    found = identified(study)
    off = []
    for names, share in ((WELL_DETERMINED, 0.02), (WEAKLY_DETERMINED, 0.10)):
        for name in names:
            truth, (value, sigma) = study.simulate.truth[name], found[name]
            if abs(value - truth) > max(share * truth, 3.0 * sigma):
                off.append(f"{name} = {value:.6g} +- {sigma:.2g}, truth {truth:.6g}")
    assert not off, "; ".join(off)
