"""Energy balance of a run: what the load put in, what became heat, where the heat went."""

from __future__ import annotations

import numpy as np

from thermofit.body.solve.march import Balance, History
from thermofit.records.artefact import Dataset


def energy_totals(history: History) -> dict[str, float]:
    """Energies of the whole run and specimen in mJ: work of the load, dissipated, thermoelastic, outflow per surface, stored heat.

    `heat_defect` is stored - (dissipated + thermoelastic - outflow): zero up to the solver. `smallest_dissipation` (mJ/mm^3) is
    the smallest of all points and steps; negative violates the second law.
    """
    surfaces = history.balance[0].outflow if history.balance else {}
    return {
        "work": history.total("work"),
        "dissipated": history.total("dissipated"),
        "thermoelastic": history.total("thermoelastic"),
        **{f"outflow_{name}": sum(step.outflow[name] for step in history.balance) for name in surfaces},
        "stored": history.total("stored"),
        "heat_defect": history.total("heat_defect"),
        "smallest_dissipation": min((step.smallest_dissipation for step in history.balance), default=0.0),
    }


def energy_curves(history: History) -> dict[str, Dataset]:
    """The energies accumulated since the start, mJ (n_steps,), as datasets of an artefact; `time` s is that of their steps."""
    surfaces = history.balance[0].outflow if history.balance else {}
    series = {name: _summed(history.balance, name) for name in ("work", "dissipated", "thermoelastic", "stored")}
    series |= {f"outflow_{name}": _running([step.outflow[name] for step in history.balance]) for name in surfaces}
    return {
        "energy/time": Dataset(history.time, "s", ("step",)),
        **{f"energy/{name}": Dataset(values, "mJ", ("step",)) for name, values in series.items()},
    }


def _summed(balance: tuple[Balance, ...], name: str) -> np.ndarray:
    return _running([float(getattr(step, name)) for step in balance])


def _running(values: list[float]) -> np.ndarray:
    """Running sum from zero at the first time."""
    return np.concatenate([[0.0], np.cumsum(values)])
