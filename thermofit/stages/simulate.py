"""`simulate`: a virtual experiment, from a study's truth to a raw folder as a laboratory would leave it."""

from __future__ import annotations

import numpy as np

from thermofit.body.body import Body, tension_body
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.solve.loading import acting_force
from thermofit.body.solve.march import History, Loading, MarchSettings, Watch, march
from thermofit.body.solve.newton import NewtonSettings
from thermofit.core.digest import path_digest
from thermofit.core.errors import StudyError
from thermofit.core.experiment import CELSIUS, Specimen
from thermofit.core.jit import set_threads
from thermofit.core.parameters import NAMES, Parameters, param, physical_bounds
from thermofit.effects.catalogue import KINEMATICS, LOAD, MEASUREMENT, effects
from thermofit.law.page import in_model_axes
from thermofit.records.artefact import Dataset, ParameterResult
from thermofit.records.key import read_of
from thermofit.records.progress import progress
from thermofit.records.staging import Made, Outcome, each, job, produce
from thermofit.study.section import MeshSize, mesh_size
from thermofit.study.study import Study
from thermofit.study.virtual import Simulate
from thermofit.virtual.laboratory import RawSummary, write_raw
from thermofit.virtual.machine import LoadHistory, bar_of, describe_programme, load_history, programme_of, uniaxial_law
from thermofit.virtual.setup import VirtualFields, instrument_times, solution_times

NAME = "simulate"
_FORCES = np.concatenate([[0.0], np.geomspace(1.0, 1e7, 36)])
"""Forces in N at which it is asked whether an effect of the machine changes the force."""


def run(study: Study, *, force: bool = False) -> Outcome:
    """Write `<run_dir>/raw` and the record of its truth; fresh where settings and raw folder are unchanged.

    StudyError where the study describes no virtual experiment or the material cannot carry its programme; NumericsError where
    the forward model fails.
    """
    if study.experiments:
        return each(study, NAME, run, lambda one: one.virtual, force=force)
    settings = _settings(study)
    refuse_unseen(study)
    own = {"hardening": settings.hardening_law or study.hardening_law, "yield_surface": settings.yield_surface or study.yield_surface}
    study = study.model_copy(update=own)
    task = job(study.run_dir, NAME, read_of(study, "name", "hardening", "yield_surface", "material_axes", "simulate", "numerics"), {})
    raw = study.run_dir / "raw"
    outcome = produce(task, lambda: _make(study, settings), force=force or not raw.is_dir())
    if outcome.fresh and outcome.record.summary.get("raw_digest") != path_digest(raw):
        outcome = produce(task, lambda: _make(study, settings), force=True)
    return outcome


def _settings(study: Study) -> Simulate:
    if study.simulate is None:
        raise StudyError(f"{study.source.name}: key 'simulate' is missing: add it to make a virtual experiment, see `thermofit new`")
    return study.simulate


def _make(study: Study, settings: Simulate) -> Made:
    set_threads(study.numerics.threads)
    fields, history = virtual_fields(study, settings)
    raw = study.run_dir / "raw"
    summary = write_raw(raw, fields, settings, settings.seed)
    return _made(study, study.truth_parameters(), history, summary, path_digest(raw))


def virtual_fields(study: Study, settings: Simulate) -> tuple[VirtualFields, History]:
    """What the instruments of a virtual experiment look at, and the run behind it. StudyError, NumericsError as `run`."""
    truth = study.truth_parameters()
    specimen = settings.specimen.lengths()
    steps = programme_of(settings.programme)
    law = uniaxial_law(in_model_axes(truth, study.material_axes.angle, study.slots), study.slots)
    load = load_history(steps, bar_of(specimen, law), settings.machine, settings.force.rate)
    dic_time, ir_time = instrument_times(load, settings, settings.seed)
    times = solution_times(load, dic_time, ir_time, study.numerics.max_time_step, settings.max_time_step or np.inf)
    body, history = _solve(study, truth, specimen, mesh_size(settings.mesh), load, times)
    face = body.mesh.node_sets["face"]
    fields = VirtualFields(
        specimen=specimen,
        load=load,
        top=np.interp(load.time, history.time, history.u_top),
        face=body.mesh.nodes[face, :2],
        dic_time=dic_time,
        dic_u=history.u[np.searchsorted(times, dic_time - 1e-9)][:, face],
        ir_time=ir_time,
        ir_u=history.u[np.searchsorted(times, ir_time - 1e-9)][:, face],
        ir_theta=history.theta[np.searchsorted(times, ir_time - 1e-9)][:, face],
        theta_air=truth["theta_air"],
        theta_clamp=truth["theta_clamp"],
        programme=describe_programme(steps),
    )
    return fields, history


def refuse_unseen(study: Study) -> None:
    """StudyError where the truth holds an effect that nothing of a virtual experiment would show: the instruments and what is between them
    and the specimen have settings of their own, and of the machine only what changes its force acts on the specimen."""
    truth = study.truth_parameters()
    on = [e for e in effects((*LOAD, *KINEMATICS, *MEASUREMENT)) if e.is_on(truth)]
    for e in on:
        alone = Parameters.of({name: truth[name] for name in e.names})
        if e.slot not in LOAD or np.array_equal(acting_force(_FORCES, alone), _FORCES):
            name = next(p.name for p in e.amplitudes if truth[p.name] != p.neutral)
            raise StudyError(
                f"{study.source.name}: key 'simulate.truth.{name}' belongs to {e.name}, which acts on the measurement or the machine, and "
                "no virtual test would show it; leave the key out (see simulate.machine, simulate.dic, simulate.ir and simulate.force)"
            )


def _solve(
    study: Study, truth: Parameters, specimen: Specimen, size: MeshSize, load: LoadHistory, times: np.ndarray
) -> tuple[Body, History]:
    body = tension_body(dogbone_mesh(specimen, size.n_x, size.n_y, size.n_z))
    numerics = study.numerics
    settings = MarchSettings(
        newton=NewtonSettings(tolerance=numerics.newton_tolerance),
        coupling_tolerance=numerics.coupling_tolerance,
        heat_scheme=numerics.heat_integration,
        model=study.slots,
        closed_form=numerics.plastic_integration == "closed-form",
        material_angle=study.material_axes.angle,
    )
    with progress("simulate", len(times) - 1) as advance:
        return body, march(body, truth, Loading(load.time, load.force), times, settings, Watch(step=lambda _: advance()))


def _made(study: Study, truth: Parameters, history: History, raw: RawSummary, digest: str) -> Made:
    parameters = {
        name: ParameterResult(truth[name], None, param(name).unit, False, False, truth[name], *physical_bounds(name)) for name in NAMES
    }
    work, outflow = history.total("work"), sum(sum(b.outflow.values()) for b in history.balance)
    summary = {
        "verdict": f"virtual experiment written to {study.run_dir / 'raw'}: " + ", ".join(f"{n} {name}" for name, n in raw.counts.items()),
        "counts": raw.counts,
        "truth": raw.truth,
        "raw_digest": digest,
        "solver": history.counts,
        "energy_mJ": {
            "work": work,
            "dissipated": history.total("dissipated"),
            "thermoelastic": history.total("thermoelastic"),
            "outflow": outflow,
            "stored": history.total("stored"),
            "heat_defect": sum(b.heat_defect for b in history.balance),
        },
        "largest_temperature_degC": float(history.theta.max()) - CELSIUS,
    }
    datasets = {
        "time": Dataset(history.time, "s", ("time",)),
        "force": Dataset(history.force, "N", ("time",)),
        "u_top": Dataset(history.u_top, "mm", ("time",)),
    }
    return Made(datasets, summary, parameters, study.simulate.seed if study.simulate else None)
