"""`identify-thermal`: thermal parameters and boundary coefficients from the temperatures (thesis 5.1.1, step 3)."""

from __future__ import annotations

from thermofit.experiment.computed_motion import taken_as_exact
from thermofit.experiment.protocol import FieldTest
from thermofit.identify.solve import Solved
from thermofit.identify.stage import StageKind, identify
from thermofit.records.staging import Note, Outcome
from thermofit.study.study import Study


def _remarks(test: FieldTest, solved: Solved) -> tuple[str, ...]:
    """Which heat capacity is it, what the boundary temperatures were, and which parameters of a computed motion are taken as exact."""
    p = solved.parameters
    exact = taken_as_exact(test.study) if test.data.displacement is None else ()
    bulk = p["E"] / (3.0 * (1.0 - 2.0 * p["nu"]))
    pressure = p["c0"] + 9.0 * bulk * p["alpha_exp"] ** 2 * p["theta_ref"]
    return (
        Note(f"for comparison with handbooks: c_p = {pressure:.3f} mJ/(mm^3 K); c0 is at constant elastic strain"),
        Note(
            f"air {p['theta_air']:.2f} K and jaws {p['theta_clamp']:.2f} K are taken as given; a thermocouple has an error of about 0.1 K"
        ),
        *((f"{', '.join(exact)} are taken as exact: state their errors under uncertainty.parameters",) if exact else ()),
    )


KIND = StageKind("identify-thermal", "thermal", _remarks)
NAME = KIND.name


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record of the thermal stage; needs those of `identify-elastic` and `identify-plastic`."""
    return identify(study, KIND, force=force)
