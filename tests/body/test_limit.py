"""Beyond the load maximum: displacement control, arc control, and what a prescribed force says there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from necked_bar import AREA, bar, necked, run
from small_bodies import ADIABATIC, SPECIMEN, bar_mesh

from thermofit.body.body import Body, tension_body
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.solve import newton
from thermofit.body.solve.linear import Factor
from thermofit.body.solve.march import History, Loading, MarchSettings, march
from thermofit.core.errors import NumericsError, StudyError

COLD = ADIABATIC.replace(alpha_exp=0.0)


@pytest.fixture(scope="module")
def pulled() -> History:
    """A necked bar drawn by 9 mm of 30, far beyond its load maximum."""
    return run(necked("displacement"), [0.0, 1.0], [0.0, 9.0], steps=60)


def follow(body: Body, value: list[float], steps: int, **settings: Any) -> History:
    marks = np.linspace(0.0, 1.0, len(value))
    return march(body, ADIABATIC, Loading(marks, np.array(value), "arc"), np.linspace(0.0, 1.0, steps + 1), MarchSettings(**settings))


@pytest.fixture(scope="module")
def followed() -> History:
    return follow(necked(), [0.0, 6.0], 60)


def test_displacement_control_passes_the_load_maximum(pulled: History) -> None:
    """The force falls by a fifth; the laws of thermodynamics hold on the way; the neck is warm."""
    peak = int(np.argmax(pulled.force))
    assert 10 < peak < 40 and pulled.force[-1] < 0.85 * pulled.force[peak]
    assert np.all(np.diff(pulled.largest_multiplier) >= 0.0)
    assert all(step.smallest_dissipation >= 0.0 and abs(step.heat_defect) < 1e-8 * step.dissipated for step in pulled.balance[5:])
    narrow = np.abs(necked().mesh.nodes[:, 1] - 15.0) < 1.0
    assert pulled.theta[-1][narrow].max() > pulled.theta[-1].min() + 1.0


def test_load_maximum_of_a_homogeneous_bar_is_consideres() -> None:
    """d(ln M_22) / dLambda = r at the maximum: M_22 = sigma_y / r, P = M_22 exp(-r Lambda - M_22 / E), r = sqrt(F + H)."""
    v, r = COLD.values, np.sqrt(COLD["F"] + COLD["H"])
    multiplier = np.linspace(0.0, 0.4, 4001)
    mandel = (v["M_yinf"] - (v["M_yinf"] - v["M_y0"]) * np.exp(-v["H_exp"] * multiplier)) / r
    nominal = mandel * np.exp(-r * multiplier - mandel / v["E"])
    stretch = np.exp(r * multiplier + mandel / v["E"])
    end = 30.0 * (stretch[np.argmax(nominal)] * 1.04 - 1.0)
    loading = Loading(np.array([0.0, 1.0]), np.array([0.0, end]), "displacement")
    history = march(bar("displacement"), COLD, loading, np.linspace(0.0, 1.0, 41))
    peak = int(np.argmax(history.force))
    assert peak < 40
    assert history.force.max() == pytest.approx(4.0 * AREA * nominal.max(), rel=1e-4)
    assert history.u_top[peak] / 30.0 == pytest.approx(stretch[np.argmax(nominal)] - 1.0, abs=0.015)


def test_a_dogbone_passes_its_load_maximum() -> None:
    """The specimen of the thesis; its necking is as the mesh lets it be, the maximum of the force is not."""
    maxima = []
    for counts in ((2, 16, 1), (3, 24, 1)):
        body = tension_body(dogbone_mesh(SPECIMEN, *counts), control="displacement")
        loading = Loading(np.array([0.0, 100.0]), np.array([0.0, 32.0]), "displacement")
        history = march(body, COLD, loading, np.linspace(0.0, 100.0, 51))
        assert history.force[-1] < 0.98 * history.force.max()
        maxima.append(history.force.max())
    assert maxima[1] == pytest.approx(maxima[0], rel=2e-3)


def test_a_prescribed_force_beyond_the_maximum_names_the_maximum(pulled: History) -> None:
    maximum = pulled.force.max()
    with pytest.raises(NumericsError) as failure:
        run(necked(), [0.0, 1.0], [0.0, 1.05 * maximum], steps=40)
    text = str(failure.value)
    assert "prescribe the displacement of the end" in text
    named = float(text.split("maximum force reached is ")[1].split(" N")[0])
    assert named == pytest.approx(maximum, rel=1e-3)


def test_arc_control_passes_the_load_maximum_on_the_path_of_displacement_control(followed: History) -> None:
    """The same end displacements prescribed give the same forces, before and beyond the maximum."""
    peak = int(np.argmax(followed.force))
    assert 20 < peak < 50 and followed.force[-1] < 0.85 * followed.force[peak]
    moved = march(necked("displacement"), ADIABATIC, Loading(followed.time, followed.u_top, "displacement"), followed.time)
    assert moved.force == pytest.approx(followed.force, abs=1e-4 * followed.force[peak])
    assert np.abs(moved.u - followed.u).max() < 1e-4 * np.abs(followed.u).max()
    assert followed.counts["bisections"] == 0


def test_the_tangent_of_a_free_end_is_indefinite_beyond_the_maximum(monkeypatch: pytest.MonkeyPatch, followed: History) -> None:
    """There LU takes over from Cholesky, and Newton still converges."""
    positive: list[bool] = []

    class Recorded(Factor):
        def __init__(self, *args: Any) -> None:
            super().__init__(*args)
            positive.append(self.positive)

    monkeypatch.setattr(newton, "Factor", Recorded)
    again = follow(necked(), [0.0, 6.0], 60)
    assert np.array_equal(again.force, followed.force)
    assert all(positive[:100]) and not any(positive[-100:])


def test_steps_have_the_arc_length(followed: History) -> None:
    """s^2 = (1/V) int |du|^2 dV + (dF / k)^2, k the elastic stiffness of the end."""
    body = necked()
    fine = follow(body, [0.0, 0.01], 2)
    stiffness = (fine.force[2] - fine.force[1]) / (fine.u_top[2] - fine.u_top[1])
    weight = np.bincount(body.mesh.hexes.ravel(), np.repeat(body.data.volume.sum(axis=1) / 8.0, 8)) / body.data.volume.sum()
    du = np.diff(followed.u, axis=0)
    length = np.sqrt(np.einsum("n,tni,tni->t", weight, du, du) + (np.diff(followed.force) / stiffness) ** 2)
    assert length == pytest.approx(np.full(60, 0.1), rel=0.01)


def test_arc_control_goes_back_along_an_elastic_path(followed: History) -> None:
    """A falling arc length unloads, a growing one loads again."""
    back = follow(necked(), [0.0, 2.0, 1.9, 2.1], 60)
    n = 20
    assert np.all(np.diff(back.force[n : n + 21]) < 0.0) and np.ptp(back.largest_multiplier[n : n + 29]) < 1e-6
    slope = np.diff(back.force[n : n + 11]) / np.diff(back.u_top[n : n + 11])
    assert np.ptp(slope) < 0.01 * slope.mean() and slope.mean() > 5.0 * (back.force[n] - back.force[n - 1]) / (
        back.u_top[n] - back.u_top[n - 1]
    )
    assert back.force[-1] == pytest.approx(back.force[n], rel=0.02)


def test_arc_control_passes_a_snap_back() -> None:
    """A long bar with a short neck: beyond the maximum its end moves back while the neck goes on; no displacement control can do that."""
    mesh = bar_mesh((2, 30, 1), (4.0, 1200.0, 1.0), air=("x1", "z1"), clamp=("y0", "y1"))
    y = mesh.nodes[:, 1]
    mesh.nodes[:, 1] = 600.0 * (1.0 + np.sign(y - 600.0) * np.abs(y / 600.0 - 1.0) ** 3)
    mesh.nodes[:, 0] *= 1.0 - 0.05 * np.exp(-(((mesh.nodes[:, 1] - 600.0) / 5.0) ** 2))
    soft = COLD.replace(M_y0=280.0, M_yinf=292.0)
    body = tension_body(mesh)
    history = march(body, soft, Loading(np.array([0.0, 1.0]), np.array([0.0, 8.0]), "arc"), np.linspace(0.0, 1.0, 81))
    peak = int(np.argmax(history.u_top))
    assert int(np.argmax(history.force)) < peak < 75
    assert history.u_top[-1] < history.u_top[peak] - 0.2 and history.force[-1] < 0.9 * history.force[peak]
    assert np.all(np.diff(history.largest_multiplier[peak:]) > 1e-3)


def test_wrong_use_of_arc_control_is_told() -> None:
    with pytest.raises(StudyError, match="other control"):
        follow(necked("displacement"), [0.0, 1.0], 4)
    with pytest.raises(StudyError, match="stands still"):
        follow(necked(), [0.0, 0.1, 0.1], 4)
    with pytest.raises(StudyError, match="control 'sideways'"):
        march(bar(), COLD, Loading(np.array([0.0, 1.0]), np.zeros(2), "sideways"), np.array([0.0, 1.0]))
