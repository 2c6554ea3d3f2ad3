"""thermofit as a library: cheap to import, typed, and its arrays are those of the artefacts. Its notebooks run."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import verify_fixtures as made

import thermofit
from thermofit.core.errors import DataError, StudyError
from thermofit.records.artefact import of_parameters
from thermofit.study.study import Study

ROOT = Path(__file__).resolve().parents[1]
COVARIANCE = np.array([[4.0, 1.0, 0.0, 0.0], [1.0, 9.0, 0.0, 0.0], [0.0, 0.0, 0.5, 0.0], [0.0, 0.0, 0.0, 1e-4]])


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """A run that is identified but not verified."""
    study = made.study_in(tmp_path_factory.mktemp("library"), experiment=None, simulate={"truth": made.VALUES})
    matrix = of_parameters(COVARIANCE, ("parameter", "parameter"), ("MPa", "MPa", "1", "1"))
    stages = [made.identified(name, made.TRUTH, **({"covariance": matrix} if "plastic" in name else {})) for name in made.FREE]
    made.write_all(study, made.interpolated(made.coupled_run()), *stages)
    return study


@pytest.fixture(scope="module")
def result(study: Study) -> thermofit.Result:
    """Its results, `verify` run by the library."""
    thermofit.run_stage(study, "verify")
    return thermofit.open_run(study.run_dir)


def test_import_costs_nothing() -> None:
    """Under 0.1 s beyond Python, and neither numpy nor numba nor h5py is there yet."""
    code = (
        "import sys, time; begin = time.process_time(); import thermofit; spent = time.process_time() - begin; "
        "assert not {'numpy', 'numba', 'h5py', 'typer'} & set(sys.modules), 'heavy modules'; print(spent)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 0.1


def test_names_are_there_and_no_others() -> None:
    assert set(dir(thermofit)) >= {"load_study", "run", "open_record", "Result", "__version__"}
    assert all(getattr(thermofit, name) is not None for name in dir(thermofit))
    with pytest.raises(AttributeError, match="it gives"):
        thermofit.identify_everything  # noqa: B018
    stub = (ROOT / "thermofit" / "__init__.pyi").read_text()
    assert [name for name in dir(thermofit) if f" as {name}\n" not in stub and f"\n{name}: " not in stub] == []


def test_a_study_takes_settings_by_keywords(study: Study, tmp_path: Path) -> None:
    found = thermofit.load_study(study.source, run_dir=tmp_path, mesh="coarse", stages__thermal__free=["beta"], parameters__kappa=120.0)
    assert found.run_dir == tmp_path and found.stages.thermal.free == ("beta",) and found.parameters["kappa"] == 120.0
    with pytest.raises(StudyError, match="mesh"):
        thermofit.load_study(study.source, mesh="corse")


def test_results_are_arrays(result: thermofit.Result) -> None:
    assert result.stages[-1] == "verify" and "verify" in repr(result)
    assert result.parameters["F"].value == made.VALUES["F"] and "kappa" in result.parameters
    u = result.field("u")
    assert u.value.shape == u.sigma.shape == (len(u.time), len(u.xy), 2) and u.unit == "mm"
    assert u.predicted is not None and np.nanmax(np.abs(u.predicted - u.value - u.error)) == 0.0
    assert np.isnan(u.error[~u.mask]).all()
    assert result.field("u", "interpolate").predicted is None
    with pytest.raises(DataError, match="no model"):
        result.field("u", "interpolate").error  # noqa: B018
    energy = result.curves("energy")
    assert energy["work"].shape == energy["time"].shape
    assert result.channels["du"]["unit"] == "mm" and result.verdict.startswith(("verified", "not verified"))
    assert result.trustworthy is (result.verdict.startswith("verified"))
    assert result.json("verify")["stage"] == "verify"


def test_covariance_and_correlation(result: thermofit.Result) -> None:
    found = result.covariance("identify-plastic")
    assert found.names == ("M_y0", "M_yinf", "H_exp", "F") and found.units == ("MPa", "MPa", "1", "1")
    np.testing.assert_array_equal(found.value, COVARIANCE)
    assert found.correlation[0, 1] == pytest.approx(1.0 / 6.0)


def test_fields_become_xarray(result: thermofit.Result) -> None:
    pytest.importorskip("xarray")
    u = result.field("u")
    data = u.to_xarray()
    assert data["value"].dims == ("time", "point", "component") and data.attrs["unit"] == "mm"
    np.testing.assert_array_equal(data["predicted"].values, u.predicted)


def test_xarray_that_is_missing_is_told(result: thermofit.Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(StudyError, match=r"thermofit\[notebook\]"):
        result.field("u").to_xarray()


def test_wrong_requests_are_told(result: thermofit.Result, study: Study, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="has not run"):
        result.record("gridsearch")
    with pytest.raises(DataError, match="there are"):
        result.curves("energies")
    with pytest.raises(StudyError, match="is no folder"):
        thermofit.open_run(tmp_path / "nothing")
    with pytest.raises(StudyError, match="not known"):
        thermofit.run_stage(study, "identify-plastik")
    with pytest.raises(DataError, match="no field"):
        thermofit.open_run(tmp_path).field("u")


def test_run_hears_of_every_stage(study: Study, result: thermofit.Result) -> None:
    """What is fresh is not computed again."""
    told: list[str] = []
    again = thermofit.run(study, first="verify", until="verify", tell=lambda done: told.append(f"{done['stage']} {done['fresh']}"))
    assert told == ["verify True"] and again.folder == result.folder


def test_demo_study_is_written_once(tmp_path: Path) -> None:
    path = thermofit.demo_study(tmp_path / "demo")
    path.write_text("name: mine\n")
    assert thermofit.demo_study(tmp_path / "demo").read_text() == "name: mine\n"
    fresh = thermofit.load_study(thermofit.demo_study(tmp_path / "other"))
    assert fresh.name == "quickstart" and fresh.virtual


@pytest.mark.slow
@pytest.mark.as_written
@pytest.mark.parametrize("name", ["identify", "diagnose", "own-effect"])
def test_notebook_runs_as_written(name: str, tmp_path: Path) -> None:
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    code = (
        "import sys, nbformat; from nbclient import NotebookClient; nb = nbformat.read(sys.argv[1], 4); "
        "NotebookClient(nb, timeout=900, resources={'metadata': {'path': sys.argv[2]}}).execute(); nbformat.write(nb, sys.argv[3])"
    )
    source, out = ROOT / "docs" / "notebooks" / f"{name}.ipynb", tmp_path / "out.ipynb"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    begin = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code, source, tmp_path, out], capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr[-3000:]
    assert time.monotonic() - begin < 900.0 and nbclient is not None
    printed = "".join(o.get("text", "") for cell in nbformat.read(out, 4).cells for o in cell.get("outputs", ()))
    expected = {"identify": "M_yinf", "diagnose": "clamp_drift", "own-effect": "my_jaws"}[name]
    assert expected in printed
