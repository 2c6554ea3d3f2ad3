"""Small unlisted terms that are told for what they move, where with all errors known they move nothing.

No block of a channel shows such a term, and held-out data gain less by it than is surely worth it. It is asked for where it moves a
parameter of the material far: by many of its standard errors by the noise, and by a fiftieth of its value. Beside it standard errors hold
more: what else may be there (`unlisted_second`), the mesh, the time steps, the landmarks. Where every parameter of the material stays
within AWAY of those, nobody learns anything by the term. It is not told then. It is one of the histories that nothing tells (`quiet`), and
intervals hold what it would make of the parameters.
"""

from __future__ import annotations

from thermofit.diagnose.beside_source import BesideSource
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.trace import material_of
from thermofit.diagnose.trial import AWAY
from thermofit.diagnose.unlisted import WORTH, Unlisted, standing


def moves_nothing(closed: Closed, missing: Unlisted | None, beside: BesideSource | None) -> bool:
    """Whether an unlisted term of a body that no block shows and that gains no more than WORTH leaves all parameters of the material within
    AWAY of the standard errors that they have `beside` it; False where these are not known."""
    here = closed.last
    if missing is None or missing.field is None or beside is None or not beside.sigma or missing.field.proof.gain > WORTH:
        return False
    if any(s.blocks.channel == missing.channel for s in standing(here, closed.numerical)):
        return False
    parameters = here.case.parameters
    names = [parameters.free[k] for k in material_of(here.case, answered=True)]
    if not names:
        return False
    return all(abs(beside.value[n] - parameters[n]) <= AWAY * beside.sigma[n] for n in names if n in beside.sigma)
