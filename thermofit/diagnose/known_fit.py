"""The joint fit of `diagnose`, kept in its record as it was, so that `close-loop` begins where it ended instead of fitting once more.

Numbers are kept to the last bit: what follows from a fit that was read is what follows from one that was made. Besides the fit, the record
holds the ends of the refits on the known motion, which the first round of the loop asks for as `diagnose` has.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from typing import Any, cast

import numpy as np

from thermofit.core.jsonable import json_text
from thermofit.core.parameters import Parameters, units_of
from thermofit.diagnose.refit import Ends
from thermofit.fit.covariance import Covariance, NullDirection
from thermofit.fit.evaluate import Counts, LoggedEvaluation
from thermofit.fit.result import FitResult, Optimality
from thermofit.records.artefact import Dataset, Record, fresh, of_parameters, open_record
from thermofit.records.staging import Job

_ROOM = "joint"
"""Group of the datasets."""
_MATRICES = ("matrix", "matrix_unit", "correlation_sensitivity", "correlation_parameters")
_VECTORS = ("sigma", "sigma_unit", "at_bound")
_SCALARS = ("s2", "n", "degrees_of_freedom", "condition")


@dataclass(frozen=True)
class KnownFit:
    """A joint fit that has been made: parameters where it is traced, the fit, starts of it that failed, and ends of refits on known motions
    by what they depend on."""

    parameters: Parameters
    fit: FitResult
    failures: tuple[str, ...]
    ends: Ends


def known_fit_datasets(known: KnownFit) -> dict[str, Dataset]:
    """Datasets of the record of `diagnose` from which `known_fit` reads the same."""
    fit, log = known.fit, known.fit.log
    facts = {
        "names": fit.names,
        "method": fit.method,
        "algorithm": fit.algorithm,
        "converged": bool(fit.converged),
        "message": fit.message,
        "counts": asdict(fit.counts),
        "free": known.parameters.free,
        "values": list(known.parameters.values),
        "failures": known.failures,
        "log": [{"number": e.number, "failed": e.failed, "reason": e.reason, "purpose": e.purpose, "replayed": e.replayed} for e in log],
        "null": [] if fit.covariance is None else [{"names": d.names, "weights": d.weights} for d in fit.covariance.null],
        "ends": [[key, dict(there.values), there.free, said] for key, (there, said) in known.ends.items()],
    }
    units, per = units_of(fit.names), ("parameter",)
    out = {
        "facts": Dataset(np.array(json_text(facts)), "1", ()),
        "values": Dataset(np.array(list(known.parameters.values.values())), "1", ("value",)),
        "f": Dataset(np.array(fit.f), "1", ()),
        "x": of_parameters(fit.x, per, units),
        "residual": Dataset(fit.residual, "1", ("row",)),
        "at_bound": Dataset(fit.at_bound, "1", per),
        "log/x": of_parameters(np.array([e.x for e in log]).reshape(-1, len(fit.names)), ("evaluation", "parameter"), units),
        "log/f": Dataset(np.array([e.f for e in log]), "1", ("evaluation",)),
        "log/seconds": Dataset(np.array([e.seconds for e in log]), "s", ("evaluation",)),
    }
    if fit.jacobian is not None:
        out["jacobian"] = of_parameters(fit.jacobian, ("row", "parameter"), tuple(_inverse(unit) for unit in units))
    if fit.sigma is not None:
        out["sigma"] = of_parameters(fit.sigma, per, units)
    if fit.optimality is not None:
        out["optimality"] = Dataset(np.array([fit.optimality.step, fit.optimality.drop]), "1", ("step_and_drop",))
    if (spread := fit.covariance) is not None:
        for name in _MATRICES:
            square = ("parameter", "parameter")
            value = getattr(spread, name)
            own = of_parameters(value, square, units) if name.startswith("matrix") else Dataset(value, "1", square)
            out[f"covariance/{name}"] = own
        for name in _VECTORS:
            value = getattr(spread, name)
            out[f"covariance/{name}"] = of_parameters(value, per, units) if name.startswith("sigma") else Dataset(value, "1", per)
        for name in _SCALARS:
            out[f"covariance/{name}"] = Dataset(np.array(getattr(spread, name)), "1", ())
    return {f"{_ROOM}/{name}": value for name, value in out.items()}


def known_fit(task: Job) -> KnownFit | None:
    """The joint fit in the record of `diagnose` with that job; None where there is none, or where it is not fresh.

    Its runs count as replayed: none of them is made again. DataError where the record is damaged.
    """
    if not fresh(task.path, task.stage, task.config, task.inputs):
        return None
    record = open_record(task.path)
    if not record.has(f"{_ROOM}/facts"):
        return None
    get = _reader(record)
    facts = json.loads(str(get("facts")))
    names, counts = tuple(facts["names"]), Counts(**facts["counts"])
    seconds, f, x = get("log/seconds"), get("log/f"), get("log/x")
    log = tuple(
        LoggedEvaluation(e["number"], x[k], float(f[k]), e["failed"], e["reason"], float(seconds[k]), e["purpose"], True)
        for k, e in enumerate(facts["log"])
    )
    step = get("optimality")
    fit = FitResult(
        names=names,
        method=facts["method"],
        algorithm=facts["algorithm"],
        x=get("x"),
        f=float(get("f")),
        residual=get("residual"),
        jacobian=get("jacobian"),
        covariance=_covariance(names, facts, record),
        sigma=get("sigma"),
        optimality=None if step is None else Optimality(float(step[0]), float(step[1])),
        at_bound=get("at_bound").astype(bool),
        converged=facts["converged"],
        message=facts["message"],
        counts=replace(counts, forward=0, linearised=0, replayed=counts.forward + counts.replayed, wall_s=0.0),
        log=log,
    )
    values = dict(zip(facts["values"], get("values").tolist(), strict=True))
    ends = {key: (Parameters(at, tuple(free)), tuple(said)) for key, at, free, said in facts["ends"]}
    return KnownFit(Parameters(values, tuple(facts["free"])), fit, tuple(facts["failures"]), ends)


def _covariance(names: tuple[str, ...], facts: dict[str, Any], record: Record) -> Covariance | None:
    if not record.has(f"{_ROOM}/covariance/matrix"):
        return None
    get = _reader(record)
    arrays = {name: get(f"covariance/{name}") for name in (*_MATRICES, *_VECTORS)}
    scalars = {name: float(get(f"covariance/{name}")) for name in _SCALARS}
    null = tuple(NullDirection(tuple(d["names"]), tuple(d["weights"])) for d in facts["null"])
    arrays["at_bound"] = arrays["at_bound"].astype(bool)
    return Covariance(names=names, null=null, **{**arrays, **scalars, "n": int(scalars["n"])})


def _reader(record: Record) -> Any:
    def get(name: str) -> Any:
        path = f"{_ROOM}/{name}"
        return cast(Any, record[path].value) if record.has(path) else None

    return get


def _inverse(unit: str) -> str:
    """Unit of a derivative by a parameter of that unit."""
    return unit if unit == "1" else f"1/({unit})"
