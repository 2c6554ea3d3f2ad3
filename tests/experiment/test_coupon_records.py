"""What the record of `interpolate` keeps of coupon records besides time, strain and stress."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thermofit.experiment.coupon_records import CouponTest, coupon_data
from thermofit.stages import interpolate
from thermofit.study.study import load_study

STRAIN = np.linspace(0.0, 0.02, 200)
TOE = 1e-3


def read_back(folder: Path, more: str, header: str = "") -> tuple[CouponTest, ...]:
    """The test of a study on one record whose strain begins with a toe, with gaps in its lateral strain."""
    stress = np.clip(200e3 * (STRAIN - TOE), 0.0, 400.0) + 500.0 * STRAIN
    across = [f"{-0.3 * e:.9g}" if k % 50 else "" for k, e in enumerate(STRAIN)]
    rows = "".join(f"{1e3 * e:.9g},{e:.9g},{s:.9g},{a}\n" for e, s, a in zip(STRAIN, stress, across, strict=True))
    (folder / "a.csv").write_text(f"{header}t [s],e [-],s [MPa],e_t [-]\n{rows}", encoding="utf-8")
    path = folder / "study.yaml"
    record = f"{{file: a.csv, strain: 'e [-]', stress: 's [MPa]', initial_temperature_degC: 20, {more}}}"
    path.write_text(f"name: bar\nrun_dir: {folder / 'run'}\ncoupon:\n  records: [{record}]\n", encoding="utf-8")
    study = load_study(path)
    interpolate.run(study, force=True)
    return coupon_data(study).tests


def test_lateral_strain_and_its_gaps_are_kept(tmp_path: Path) -> None:
    (test,) = read_back(tmp_path, "time: 't [s]', lateral: 'e_t [-]', strain_zero: as-measured")
    assert test.lateral is not None and test.measured_clock
    assert int(np.isnan(test.lateral).sum()) == 4 and "lateral" in test.noise
    known = np.isfinite(test.lateral)
    np.testing.assert_allclose(test.lateral[known], -0.3 * STRAIN[known], atol=1e-9)
    assert read_back(tmp_path, "time: 't [s]'")[0].lateral is None


@pytest.mark.parametrize(("key", "moved"), [("", TOE), ("strain_zero: as-measured", 0.0)])
def test_the_shift_of_strain_can_be_switched_off(tmp_path: Path, key: str, moved: float) -> None:
    (test,) = read_back(tmp_path, f"time: 't [s]', {key}")
    assert STRAIN[0] - test.strain[0] == pytest.approx(moved, rel=0.05)


def test_a_clock_built_from_a_rate_is_known_as_such(tmp_path: Path) -> None:
    (test,) = read_back(tmp_path, "rate: 1.0e-3")
    assert not test.measured_clock
