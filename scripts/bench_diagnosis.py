"""Section: what the diagnosis asks of a body: the score of all dormant effects beside the forward run that it explains."""

from __future__ import annotations

import tempfile
from pathlib import Path

import operating_body as body
from bench_measure import Limits, Options, Part, Row, Target, cpu

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import Case, linearised, scans
from thermofit.experiment.joint import Joint, joint_settings, station_names
from thermofit.experiment.known_effects import effects_of_fields
from thermofit.experiment.known_motion import acts_in_heat
from thermofit.experiment.residuals import named_phases
from thermofit.study.section import MeshSize
from thermofit.study.study import Study, load_study


def measure(options: Options, limits: Limits) -> Part:
    """CPU seconds of a forward run of both fields, of the same with the fitted parameters, and of the score of the whole catalogue."""
    study, size = _study(), MeshSize(**dict(zip(("n_x", "n_y", "n_z"), options.mesh, strict=True)))
    data = body.SMALL.measured(study, {}, 1)
    joint = Joint(study, data, joint_settings(study, body.FREE, data), size)
    parameters = Parameters.of(body.TRUTH, body.FREE)
    case = Case(joint.model, parameters, effects_of_fields(infrared=True), named_phases(data.phases), station_names(), scored=joint.scored)
    # A joint model does not repeat its last run: a parameter that is moved by nothing that matters asks for another.
    numbers = iter(range(10**6))
    forward = cpu(lambda: joint.model.residual(parameters.replace(E=parameters["E"] + 1e-3 * next(numbers))), options.repeat)
    fitted = cpu(lambda: joint.model.linearised(parameters, body.FREE), options.repeat)
    whole = cpu(lambda: linearised(case), options.repeat)
    columns = sum(len(e.amplitudes) * (len(scans(e, case)) if acts_in_heat(e) else 1) for e in case.dormant())
    rows = (
        Row("forward run of both fields", forward, f"{len(data.displacement.time)} steps"),
        Row(f"the same with {len(body.FREE)} fitted parameters", fitted, f"{fitted / forward:.2f} forward runs"),
        Row(f"score of all {len(case.dormant())} dormant effects", whole, f"{whole / forward:.2f} forward runs, {columns} columns besides"),
    )
    targets = (Target("score of the whole catalogue", "5 forward runs, aim 3", f"{whole / forward:.2f}", whole <= 5.0 * forward),)
    remark = "Displacements and temperatures at 60 points; fitted parameters take part in the score."
    return Part("Diagnosis", rows, targets, (remark,))


def _study() -> Study:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.yaml"
        path.write_text(body.STUDY, encoding="utf-8")
        return load_study(path)
