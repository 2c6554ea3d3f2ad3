"""Fields of the identified model and of the measurement over time, for ParaView: series of VTU files with a PVD file, and XDMF."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

import meshio
import numpy as np
from meshio.xdmf import TimeSeriesWriter

from thermofit.body.element.stress import cauchy_stress, deformation_gradients
from thermofit.body.heat.equation import PointStates, dissipation_of_points
from thermofit.body.solve.history import State, Watch, point_history
from thermofit.core.files import replacing
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import Measured
from thermofit.experiment.forward import march_settings, run_of
from thermofit.law.page import law_in_step, law_of
from thermofit.records.artefact import Record
from thermofit.records.progress import progress
from thermofit.study.study import Study

Points = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Frame:
    """Fields at one time s: at nodes `u` mm (n_np, 3) and `theta` K (n_np,); of elements, as means over their points, `Lambda`, `alpha`,
    `F` (n_el, 9) row by row, `stress` Cauchy, MPa (n_el, 9), and `dissipation` since the beginning, mJ/mm^3 (n_el,)."""

    time: float
    nodes: Points
    elements: Points


def model_series(folder: Path, name: str, study: Study, data: Measured, parameters: Parameters) -> tuple[Path, Path]:
    """Run the coupled model of a specimen with given parameters and write every load step; returns the paths of the PVD and XDMF files.

    NumericsError where the specimen cannot carry the force.
    """
    steps = data.steps["all"]
    settings = march_settings(study, "full")
    run = run_of(study, data, study.mesh_size, steps, settings)
    law = law_of(parameters, settings.model, closed_form=settings.closed_form, plastic=settings.plastic)
    element = run.body.data
    weight = element.volume / element.volume.sum(axis=1, keepdims=True)
    released = np.zeros(weight.shape)
    before: list[tuple[float, PointStates]] = []
    series = Series(folder, name, run.body.mesh.nodes, [("hexahedron", run.body.mesh.hexes)])

    def mean(value: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("eq,eq...->e...", weight, value))

    with progress("fields", len(steps.time)) as advance:

        def collect(_: int, state: State) -> None:
            now = point_history(state.points, state.dilatation)
            if before:
                t, start = before.pop()
                dissipation_of_points(element, start, now, state.theta, law_in_step(law, state.time - t), released)
            before.append((state.time, now))
            f = deformation_gradients(element, state.u, state.dilatation)
            stress = cauchy_stress(element, f, state.theta, state.points, state.dilatation, law)
            elements = {
                "Lambda": mean(now.accumulated),
                "alpha": mean(now.alpha),
                "F": mean(f).reshape(-1, 9),
                "stress": mean(stress).reshape(-1, 9),
                "dissipation": mean(released),
            }
            series.add(Frame(state.time, {"u": state.u, "theta": state.theta}, elements))
            advance()

        run(parameters, Watch(state=collect))
    return series.close()


def measured_series(folder: Path, record: Record) -> Iterator[Path]:
    """Every field that was measured, at its points and times: measured, predicted, their difference, its standard error, and where it was
    compared the residual in standard errors. nan where there is no value."""
    for name in ("u", "theta"):
        if not record.has(f"{name}/value") or not record.has(f"{name}/xy"):
            continue
        xy, time = record[f"{name}/xy"].value, record[f"{name}/time"].value
        value, predicted, sigma = (record[f"{name}/{key}"].value for key in ("value", "predicted", "sigma"))
        mask = record[f"{name}/mask"].value[..., None]
        channel = f"residual/d{name}"
        normalised = record[channel].value if record.has(channel) else None
        if normalised is not None and normalised.shape != value.shape:
            normalised = None
        place = np.column_stack([xy, np.zeros(len(xy))])
        series = Series(folder, f"measured-{name}", place, [("vertex", np.arange(len(xy))[:, None])])
        for n, t in enumerate(time):
            shown = {
                "measured": np.where(mask[n], value[n], np.nan),
                "predicted": predicted[n],
                "error": np.where(mask[n], predicted[n] - value[n], np.nan),
                "sigma": np.where(mask[n], sigma[n], np.nan),
            }
            if normalised is not None:
                shown["residual"] = normalised[n]
            series.add(Frame(float(t), {key: _of_points(v) for key, v in shown.items()}, {}))
        yield from series.close()


def _of_points(value: np.ndarray) -> np.ndarray:
    """Scalars (n,) as they are, vectors in the plane (n, 2) with a third component, as ParaView wants them."""
    if value.shape[1] == 1:
        return np.ascontiguousarray(value[:, 0])
    return np.column_stack([value, np.zeros(len(value))])


class Series:
    """Writes frames one by one as `<name>/<name>_0000.vtu` and at last `<name>.pvd`, which gives each its time in s; beside it the same as
    one `<name>.xdmf` with `<name>.h5`."""

    def __init__(self, folder: Path, name: str, points: np.ndarray, cells: Sequence[tuple[str, np.ndarray]]) -> None:
        self.folder, self.name, self.points, self.cells = folder, name, points, list(cells)
        self.listed: list[tuple[float, str]] = []
        (folder / name).mkdir(parents=True, exist_ok=True)
        for old in (folder / name).glob(f"{name}_*.vtu"):
            old.unlink()
        # meshio puts the data beside where it runs, not beside the XDMF file: both are written in their folder.
        self.together = TimeSeriesWriter(folder.absolute() / f"{name}.xdmf")
        with contextlib.chdir(folder):
            self.together.__enter__()
        self.together.write_points_cells(points, self.cells)

    def add(self, frame: Frame) -> None:
        """Write the fields at one more time."""
        path = self.folder / self.name / f"{self.name}_{len(self.listed):04d}.vtu"
        of_elements = {key: [np.ascontiguousarray(value)] for key, value in frame.elements.items()}
        mesh = meshio.Mesh(self.points, self.cells, point_data=dict(frame.nodes), cell_data=of_elements)
        with replacing(path, durable=False) as temporary:
            mesh.write(temporary, file_format="vtu")
        self.together.write_data(frame.time, dict(frame.nodes), {key: list(value) for key, value in of_elements.items()})
        self.listed.append((frame.time, f"{self.name}/{path.name}"))

    def close(self) -> tuple[Path, Path]:
        """Write the lists of times; returns the paths of that of the VTU files and of the XDMF file."""
        self.together.__exit__()
        entries = [f'    <DataSet timestep="{time:.9g}" part="0" file={quoteattr(file)}/>' for time, file in self.listed]
        text = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">', "  <Collection>"]
        path = self.folder / f"{self.name}.pvd"
        with replacing(path, durable=False) as temporary:
            temporary.write_text("\n".join([*text, *entries, "  </Collection>", "</VTKFile>", ""]), encoding="utf-8")
        return path, self.folder / f"{self.name}.xdmf"
