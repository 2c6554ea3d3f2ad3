"""Errors of mesh and steps: exact where the error is a power of the size, told apart by channel, and what they do to parameters."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from thermofit.core.parameters import Parameters
from thermofit.experiment.discretisation import finer_mesh
from thermofit.experiment.refinement import coarser_mesh, error_of, observed_order, refinement, spacing
from thermofit.study.section import MeshSize, SheetSize

SIZE = MeshSize(n_x=12, n_y=36, n_z=6)
X = np.linspace(0.0, 1.0, 40)
TRUE = {"E": 2.0e5, "nu": 0.3}


@dataclass(frozen=True)
class Channel:
    """Forty values of a channel with noise `sigma`."""

    channel: str
    sigma: float
    unit: str = "mm"
    n: int = len(X)

    @property
    def weight(self) -> np.ndarray:
        return np.full(self.n, self.sigma**-2)

    @property
    def spread(self) -> np.ndarray:
        return np.ones(self.n)


@dataclass(frozen=True)
class Model:
    """r = (E x / 2e5 + nu x^2 + mesh h^2 + layer + step parts^-order - its limit) / sigma, for two channels."""

    h: float
    parts: int
    names: tuple[str, ...]
    mesh: float = 3.0
    step: float = 0.02
    order: float = 1.0
    layer: float = 0.0
    linearise: Any = True

    @property
    def comparisons(self) -> tuple[Channel, ...]:
        return Channel("du", 0.01), Channel("dtheta", 0.1, "K")

    @property
    def places(self) -> dict[str, slice]:
        return {"du": slice(0, len(X)), "dtheta": slice(len(X), 2 * len(X))}

    def residual(self, p: Parameters) -> np.ndarray:
        own = (p["E"] / TRUE["E"] - 1.0) * X + (p["nu"] - TRUE["nu"]) * X**2
        off = (self.mesh * self.h**2 + self.layer) * X + self.step * self.parts**-self.order
        return np.concatenate([(own + off) / 0.01, (own + self.step / self.parts) / 0.1])

    def linearised(self, p: Parameters, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        columns = {"E": X / TRUE["E"], "nu": X**2}
        J = np.stack([columns[n] for n in names], axis=1)
        return self.residual(p), np.concatenate([J / 0.01, J / 0.1])


@dataclass(frozen=True)
class Experiment:
    """What is asked of an experiment here."""

    parts: int = 1
    scalable: bool = True
    own: tuple[tuple[str, float], ...] = ()
    layer: float = 0.0
    """Error of one layer of elements over the thickness."""
    asked: list[MeshSize] = field(default_factory=list)
    """Meshes of the models so far."""

    def joint_settings(self) -> Any:
        return type("Settings", (), {"free": ("E", "nu")})

    def with_steps(self, parts: int) -> Experiment:
        return replace(self, parts=parts)

    def finer(self, size: MeshSize) -> MeshSize:
        """Twice as many elements along the load: more than the others need."""
        mesh = finer_mesh(size)
        return mesh.with_counts({**mesh.counts, "n_y": 2 * size.n_y})

    def joint(self, settings: Any, base: Parameters, size: MeshSize) -> Any:
        self.asked.append(size)
        h = spacing(size if self.layer == 0.0 else SheetSize(n_x=size.n_x, n_y=size.n_y))
        return type("Problem", (), {"model": Model(h, self.parts, base.free, layer=self.layer / size.n_z**2, **dict(self.own))})


def found(experiment: Experiment, size: MeshSize = SIZE) -> Any:
    return refinement(experiment, Parameters.of(TRUE), size, {"E": 100.0, "nu": None})  # type: ignore[arg-type]


def test_errors_that_are_powers_are_found_exactly() -> None:
    result = found(Experiment())
    du, dtheta = result.channels
    mesh = 3.0 * spacing(SIZE) ** 2
    rms = float(np.sqrt(np.mean(X**2)))
    assert du["mesh_order"] == pytest.approx(2.0, abs=1e-9) and du["steps_order"] == pytest.approx(1.0, abs=1e-9)
    assert du["mesh_error"] == pytest.approx(mesh * rms, rel=1e-9) and du["mesh_index"] == pytest.approx(1.25 * mesh * rms, rel=1e-9)
    assert du["mesh_over_noise"] == pytest.approx(mesh * rms / 0.01, rel=1e-9) and du["unit"] == "mm"
    assert du["steps_error"] == pytest.approx(0.02, rel=1e-9) and dtheta["steps_over_noise"] == pytest.approx(0.2, rel=1e-9)
    assert dtheta["mesh_error"] == 0.0 and np.isnan(dtheta["mesh_order"])
    # du alone holds the error of the mesh, E x of it: a fit of both channels moves E by the weights of both.
    J = Model(0.1, 1, ()).linearised(Parameters.of(TRUE), ("E", "nu"))[1]
    e = np.concatenate([mesh * X / 0.01, 0.0 * X])
    shift = np.abs(np.linalg.lstsq(J, -e, rcond=None)[0])
    rows = {row["parameter"]: row for row in result.parameters}
    assert set(rows) == {"E", "nu"} and result.forward == 6
    assert rows["E"]["mesh_index"] == pytest.approx(3.0 * shift[0], rel=1e-9), "dtheta shows no order, so that the factor is 3"
    assert rows["E"]["over_sigma"] == pytest.approx(np.hypot(rows["E"]["mesh_index"], rows["E"]["steps_index"]) / 100.0)
    assert rows["nu"]["over_sigma"] is None


def test_the_finer_mesh_is_that_of_the_experiment() -> None:
    """Which is finer in the jaws of its specimen too."""
    own = Experiment()
    found(own)
    assert {SIZE, own.finer(SIZE), coarser_mesh(SIZE)} == set(own.asked) and own.finer(SIZE) != finer_mesh(SIZE)


def test_the_layer_of_a_sheet_is_told_beside_its_mesh() -> None:
    result = found(Experiment(layer=0.04), SheetSize(n_x=12, n_y=36))
    du, rms = result.channels[0], float(np.sqrt(np.mean(X**2)))
    assert du["sheet_error"] == pytest.approx(0.04 * rms) and du["sheet_order"] == pytest.approx(2.0)
    assert du["mesh_error"] == pytest.approx(3.0 / (12 * 36) * rms) and result.forward == 8
    row = result.parameters[0]
    assert row["over_sigma"] == pytest.approx(np.linalg.norm([row[f"{kind}_index"] for kind in ("mesh", "steps", "sheet")]) / 100.0)


def test_orders_that_are_not_seen_make_the_factor_large() -> None:
    du = found(Experiment(own=(("order", 3.0),))).channels[0]
    assert du["steps_order"] == pytest.approx(3.0) and du["steps_index"] == pytest.approx(3.0 * du["steps_error"])
    assert found(Experiment(own=(("order", 1.3),))).channels[0]["steps_index"] == pytest.approx(1.25 * 0.02 * (1 - 0.5**1.3) / 0.5)


def test_without_a_mesh_there_are_steps_alone() -> None:
    result = found(Experiment(scalable=False, own=(("linearise", None),)))
    assert all("mesh_error" not in row and "steps_error" in row for row in result.channels) and not result.parameters
    assert result.forward == 4


def test_order_of_three_sizes() -> None:
    h = (1.0, 0.7, 0.3)
    for p in (0.5, 1.0, 2.0, 3.7):
        assert observed_order(h[0] ** p - h[1] ** p, h[1] ** p - h[2] ** p, h) == pytest.approx(p, abs=1e-9)
        assert error_of(np.array([h[1] ** p - h[2] ** p]), h[1], h[2], p) == pytest.approx(h[1] ** p)
    assert np.isnan(observed_order(1e-9, 1.0, h)) and np.isnan(observed_order(0.0, 1.0, h)) and np.isnan(observed_order(1.0, 0.0, h))


def test_coarser_meshes_can_be_made() -> None:
    assert coarser_mesh(SIZE) == MeshSize(n_x=8, n_y=24, n_z=4)
    assert coarser_mesh(MeshSize(n_x=1, n_y=2, n_z=1)) == MeshSize(n_x=1, n_y=2, n_z=1)
