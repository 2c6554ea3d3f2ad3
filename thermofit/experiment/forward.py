"""Forward models of the stages: parameters to predicted fields at the observation points and times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.body.body import Body, tension_body
from thermofit.body.mesh.mesh import Mesh
from thermofit.body.mesh.quality import symmetry_of
from thermofit.body.mesh.specimen import specimen_mesh
from thermofit.body.sensitivity.march import StepRates
from thermofit.body.solve.gauge import GaugeLoading, march_between
from thermofit.body.solve.history import NOBODY, Watch
from thermofit.body.solve.march import History, Loading, MarchSettings, march
from thermofit.body.solve.newton import NewtonSettings
from thermofit.core.errors import DataError, StudyError
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import LoadSteps, Measured
from thermofit.observe.end_motion import Gauge
from thermofit.observe.observation import FaceOperator, FieldObservation, ReadsFace, face_operator
from thermofit.study.section import MeshSize
from thermofit.study.study import Study


def specimen_body(study: Study, data: Measured, size: MeshSize, control: str = "force") -> Body:
    """Model of the measured specimen, its upper end under force or displacement control; `symmetry` is what its mesh says."""
    mesh = specimen_mesh(study.geometry, data.specimen, size, study.mesh_file)
    return tension_body(mesh, control=control, symmetry=symmetry_of(mesh))


def loading_of(study: Study, steps: LoadSteps) -> Loading:
    """What drives the model: the smoothed force, the crosshead less compliance times force, or the elongation seen by DIC (that of its
    ends; of sections between them, `run_of` takes it as such).

    DataError where the record has no crosshead, StudyError where it was interpolated for another drive.
    """
    if study.force.drives == "force":
        return Loading(steps.time, steps.force, modes=steps.error)
    if study.force.drives == "dic":
        if steps.elongation is None:
            raise StudyError(
                f"{study.source.name}: force.drives is 'dic', but interpolate.h5 holds no elongation; run `thermofit interpolate "
                f"{study.source.name}` again"
            )
        return Loading(steps.time, steps.elongation, "displacement", from_rest=True, modes=steps.error)
    if steps.crosshead is None:
        raise DataError("force.drives is 'crosshead', but force.csv holds no column crosshead_mm; let the force drive or add the column")
    moved = steps.crosshead - steps.crosshead[0] - study.force.compliance * (steps.force - steps.force[0])
    return Loading(steps.time, moved, "displacement", from_rest=True, force=steps.force)


def run_of(study: Study, data: Measured, size: MeshSize, steps: LoadSteps, settings: MarchSettings) -> MechanicalRun:
    """The run of a study's specimen through load steps."""
    loading = loading_of(study, steps)
    body = specimen_body(study, data, size, loading.control)
    if study.force.drives == "dic" and data.gauge is not None:
        gauge = nodal_gauge(body.mesh, data.gauge)
        loading = GaugeLoading(loading.time, loading.value, loading.control, loading.from_rest, modes=loading.modes, gauge=gauge)
    return MechanicalRun(body, loading, settings)


def nodal_gauge(mesh: Mesh, gauge: Gauge) -> np.ndarray:
    """Weights (n_np,) of the nodal u_y in an elongation that is made of points of the face."""
    at = face_operator(mesh, gauge.xy)
    return np.bincount(at.node.ravel(), (at.weight * gauge.weight[:, None]).ravel(), minlength=mesh.n_nodes)


def march_settings(study: Study, coupling: str, *, plastic: bool = True, keep_points: bool = False) -> MarchSettings:
    """Numerics of a study."""
    n = study.numerics
    return MarchSettings(
        newton=NewtonSettings(tolerance=n.newton_tolerance),
        coupling=coupling,
        coupling_tolerance=n.coupling_tolerance,
        heat_scheme=n.heat_integration,
        model=study.slots,
        closed_form=n.plastic_integration == "closed-form",
        plastic=plastic,
        keep_points=keep_points,
        material_angle=study.material_axes.angle,
    )


@dataclass(frozen=True)
class MechanicalRun:
    """A mechanical (coupled) run of the specimen through given load steps."""

    body: Body
    loading: Loading
    settings: MarchSettings

    @property
    def time(self) -> np.ndarray:
        """Step times s (n_t,)."""
        return self.loading.time

    def __call__(self, parameters: Parameters, watch: Watch = NOBODY) -> History:
        """History at the load steps. NumericsError where a step fails."""
        if isinstance(self.loading, GaugeLoading):
            return march_between(self.body, parameters, self.loading, self.loading.time, self.settings, watch)
        return march(self.body, parameters, self.loading, self.loading.time, self.settings, watch)


@dataclass(frozen=True)
class Sampler:
    """Takes the fields of a history at observation points and times; every observation time is a step time of the run."""

    operator: FaceOperator
    index: np.ndarray
    reference: int

    def observed(self, name: str, history: History) -> np.ndarray:
        """Field "u", "theta" or "force" (n_t, n_s, n_c) of a history."""
        if name == "u":
            return self.displacement(history)
        return self.force(history) if name == "force" else self.temperature(history.theta)

    def observed_rates(self, name: str, at: StepRates) -> np.ndarray:
        """Derivatives (n_s, n_c, n_p) of a field at one time; those of u against the reference state, not against the resting specimen."""
        if name == "u":
            return self.operator.displacement(at.u.transpose(2, 0, 1)).transpose(1, 2, 0)
        return at.force[None, None, :] if name == "force" else self.temperature_rates(at.theta)

    def displacement(self, history: History) -> np.ndarray:
        """u - u(start) (n_t, n_s, 2) mm: the cameras measure against the resting specimen."""
        u = self.operator.displacement(history.u[np.append(self.index, self.reference)])
        return np.asarray(u[:-1] - u[-1])

    def force(self, history: History) -> np.ndarray:
        """Force on the upper end (n_t, 1, 1) N."""
        return np.asarray(history.force[self.index][:, None, None])

    def temperature(self, theta: np.ndarray) -> np.ndarray:
        """theta (n_t, n_s, 1) K from nodal temperatures (n_steps, n_np)."""
        return self.operator.temperature(theta[self.index])

    def temperature_rates(self, rates: np.ndarray) -> np.ndarray:
        """Derivatives (n_s, 1, n_p) of the temperatures at one time from nodal ones (n_np, n_p)."""
        return self.operator.temperature(rates.T).transpose(1, 2, 0)


def sampler(body: Body, observation: FieldObservation, steps: LoadSteps, operator: ReadsFace = face_operator) -> Sampler:
    """Sampler of an observation; StudyError where an observation time is not among the steps (an inconsistent artefact)."""
    index = np.searchsorted(steps.time, observation.time - 1e-7)
    index = np.minimum(index, len(steps.time) - 1)
    worst = float(np.max(np.abs(steps.time[index] - observation.time), initial=0.0))
    if worst > 1e-6:
        raise StudyError(
            f"steps: an observation time of {observation.name} is {worst:.3g} s off the load steps; run `thermofit interpolate` again"
        )
    return Sampler(operator(body.mesh, observation.xy), index, 0)
