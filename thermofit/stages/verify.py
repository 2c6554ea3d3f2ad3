"""`verify`: everything identified so far in one coupled run, against all observations and their noise."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from thermofit.core.artefact import Dataset, Record, open_record
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.core.staging import Made, Outcome, artefact_path, job, produce
from thermofit.core.study import Study
from thermofit.diagnose.coupon_verification import verified_coupons
from thermofit.diagnose.curves import moments, snapshots, stress_stretch, temperature_curves
from thermofit.diagnose.energy import energy_curves, energy_totals
from thermofit.diagnose.structure import Span, named_phases, node_rms, time_rms
from thermofit.diagnose.verification import (
    IDENTIFY,
    INFORMATION,
    Verification,
    channel_table,
    coupling_error,
    fitted_parameters,
    identified_stages,
    judge,
    phase_remarks,
    phase_table,
    verification,
)
from thermofit.identify.coupon_inputs import CouponData, coupon_data
from thermofit.identify.inputs import INTERPOLATE, Measured, field_datasets, measured, start_parameters, with_identified

NAME = "verify"
_SECTIONS = ("model", "material_axes", "mesh", "geometry", "parameters", "evaluation", "force", "numerics", "coupon")


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record with predicted fields, residuals per channel and phase, maps, curves, coupling error and energy balance.

    Stages that have not run are absent: their parameters keep the start of the study. StudyError where `interpolate` or
    `identify-elastic` is missing (names the command); NumericsError where the coupled run fails. Of coupons: every record by the point
    driver.
    """
    data = measured(study) if study.coupon is None else coupon_data(study)
    stages = identified_stages(study)
    parameters, identified = with_identified(study, start_parameters(study, data), stages)
    inputs: dict[str, Path] = {INTERPOLATE: artefact_path(study.run_dir, INTERPOLATE), **identified}
    task = job(study.run_dir, NAME, study.config_of(*_SECTIONS), inputs)
    if isinstance(data, CouponData):
        return produce(task, lambda: verified_coupons(study, data, parameters, stages), force=force)
    return produce(task, lambda: _make(study, data, parameters, stages), force=force)


def _make(study: Study, data: Measured, parameters: Parameters, stages: tuple[str, ...]) -> Made:
    set_threads(study.numerics.threads)
    begin = time.perf_counter()
    verified = verification(study, data, parameters)
    seconds = time.perf_counter() - begin
    spans = named_phases(data.phases)
    thermal = open_record(artefact_path(study.run_dir, IDENTIFY[2])) if IDENTIFY[2] in stages else None
    summary = _summary(verified, spans, stages, thermal)
    summary["evaluations"] = {"forward": 1, "failed": 0, "wall_s": seconds}
    return Made(_datasets(verified, data, spans), summary, fitted_parameters(study, parameters, stages))


def _summary(verified: Verification, spans: tuple[Span, ...], stages: tuple[str, ...], thermal: Record | None) -> dict[str, Any]:
    channels = channel_table(verified.residuals)
    rows = phase_table(verified.residuals, spans)
    found = judge(verified.residuals, rows)
    energy, coupling = energy_totals(verified.history), coupling_error(verified, thermal)
    remarks = [f"{name} has not run: its parameters keep the start of the study" for name in IDENTIFY if name not in stages]
    remarks += phase_remarks(rows, found.within)
    shown = " and ".join(name for name in INFORMATION if name in channels)
    remarks.append(f"{shown} as measured, for information: rigid-body motion, camera offset")
    if coupling is not None:
        remarks.append(f"one-way coupling: {1e3 * coupling['max_K']:.2g} mK at most, {1e3 * coupling['rms_K']:.2g} mK rms")
    if energy["smallest_dissipation"] < 0.0:
        remarks.append(f"dissipation falls to {energy['smallest_dissipation']:.2g} mJ/mm^3: against the second law, check beta")
    return {
        "verdict": found.line,
        "trustworthy": not found.outside,
        "channels": channels,
        "phases": rows,
        "coupling_error": coupling,
        "energy_mJ": {name: value for name, value in energy.items() if name != "smallest_dissipation"},
        "smallest_dissipation_mJ_mm3": energy["smallest_dissipation"],
        "stages": list(stages),
        "solver": verified.history.counts,
        "remarks": remarks,
    }


def _datasets(verified: Verification, data: Measured, spans: tuple[Span, ...]) -> dict[str, Dataset]:
    dims = ("time", "point", "component")
    out: dict[str, Dataset] = {}
    for name, observation in verified.observed.items():
        out.update(field_datasets(observation))
        out[f"{name}/predicted"] = Dataset(verified.predicted[name], observation.unit, dims)
    for field in verified.residuals:
        channel = field.channel
        if channel in ("du", "dtheta"):
            out[f"residual/{channel}"] = Dataset(field.normalised, "1", dims)
            out[f"maps/{channel}"] = Dataset(node_rms(field), "1", dims[1:])
        if channel not in INFORMATION:
            out[f"over_time/{channel}"] = Dataset(time_rms(field), "1", dims[:1])
    out |= snapshots(verified.residuals, moments(spans, verified.steps))
    out |= stress_stretch(verified, data)
    out |= temperature_curves(verified)
    out |= energy_curves(verified.history)
    return out
