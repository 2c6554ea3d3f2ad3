"""Section: what the diagnosis asks of a body: the score of all dormant effects beside the forward run that it explains."""

from __future__ import annotations

import operating_body as body
from bench_measure import Limits, Options, Part, Row, Target, cpu
from operating_draw import World

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import linearised, scans
from thermofit.experiment.known_motion import acts_in_heat
from thermofit.study.section import MeshSize

AS_DECLARED = World(seed=1, programme="usual-rate", noise=1.0, declared={})
"""The test: noise of the usual size and as it is declared."""


def measure(options: Options, limits: Limits) -> Part:
    """CPU seconds of a forward run of both fields, of the same with the fitted parameters, and of the score of the whole catalogue."""
    size = MeshSize(**dict(zip(("n_x", "n_y", "n_z"), options.mesh, strict=True)))
    data = body.SMALL.measured(AS_DECLARED, {}, body.AS_DECLARED)
    asked = body.problem(data, Parameters.of(body.TRUTH, body.FREE), size)
    model, free = asked.joint.model, asked.joint.settings.free
    parameters = Parameters.of(body.TRUTH, free)
    strain = max(float(points.accumulated.max()) for points in asked.joint.shown(parameters)[0].points)
    case = asked.case(asked.joint, data, parameters, strain)
    numbers = iter(range(10**6))

    def moved() -> Parameters:
        """A joint model does not repeat its last run: a parameter that is moved by nothing that matters asks for another."""
        return parameters.replace(E=parameters["E"] + 1e-3 * next(numbers))

    forward = cpu(lambda: model.residual(moved()), options.repeat)
    fitted = cpu(lambda: model.linearised(moved(), free), options.repeat)
    whole = cpu(lambda: linearised(case), options.repeat)
    columns = sum(len(e.amplitudes) * (len(scans(e, case)) if acts_in_heat(e) else 1) for e in case.dormant())
    rows = (
        Row("forward run of both fields", forward, f"{len(data.displacement.time)} steps"),
        Row(f"the same with {len(free)} fitted parameters", fitted, f"{fitted / forward:.2f} forward runs"),
        Row(f"score of all {len(case.dormant())} dormant effects", whole, f"{whole / forward:.2f} forward runs, {columns} columns besides"),
    )
    targets = (Target("score of the whole catalogue", "5 forward runs, aim 3", f"{whole / forward:.2f}", whole <= 5.0 * forward),)
    remark = "Displacements and temperatures at 60 points; fitted parameters take part in the score."
    return Part("Diagnosis", rows, targets, (remark,))
