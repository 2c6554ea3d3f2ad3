"""How far temperatures pull parameters of the motion from where displacements alone have them, beside an added effect of heat.

Temperatures tell of the motion through what they are made of: thermoelastic cooling, the work of flow. That is right where all of the heat
is known. An added heat has one form of many, and where it is not the true one, temperatures draw elastic and plastic parameters after it,
with all channels at their noise. Displacements do not know of the heat. With the parameters of the heat held, a step of those of the motion
(columns J_u of the displacements, residual r_u) leads to where displacements have them,

    d = -(J_u^T J_u)^+ J_u^T r_u,   var d = (J_u^T J_u)^+ - C,

C their covariance in the joint fit: what is in one estimate and not in the other (Hausman 1978, Econometrica 46). Where d is more than SURE
of its standard errors, the parameter may be anywhere between, and d is a standard error more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermofit.core.parameters import param
from thermofit.diagnose.combined import with_wider
from thermofit.diagnose.held_out import SURE
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.rescored import shown_rows
from thermofit.diagnose.widened import most_widened, widened
from thermofit.effects.catalogue import effect
from thermofit.experiment.known_motion import acting_on_temperatures, acts_in_heat
from thermofit.fit.budget import PULLED
from thermofit.fit.linear_model import LinearModel

LEAST = 0.1
"""Part of the variance by displacements alone that the variance of a difference is taken for at least: of what temperatures hardly tell,
rounding is left of it."""


def with_pulled(closed: Closed) -> Closed:
    """The loop's result with standard errors that know how far temperatures pull parameters of the motion of a body, and a remark on it;
    the same where no effect of heat was added, or they pull none."""
    here, fit = closed.last, closed.fit
    if here.case.cheap or fit.covariance is None or fit.jacobian is None or not any(acts_in_heat(effect(n)) for n in closed.accepted):
        return closed
    warm = set(acting_on_temperatures(fit.names))
    known = np.isfinite(fit.covariance.sigma)
    own = [k for k, n in enumerate(fit.names) if n not in warm and known[k] and not fit.at_bound[k]]
    rows = ~shown_rows(here)
    if not own or rows.sum() <= len(own):
        return closed
    alone = LinearModel(fit.residual[rows], fit.jacobian[rows][:, own])
    variance = np.sum(alone.root() ** 2, axis=1)
    by_noise = np.diag(fit.covariance.matrix)[own] if closed.by_noise is None else closed.by_noise[own] ** 2
    apart, spread = alone.free_step, np.sqrt(np.maximum(variance - by_noise, LEAST * variance))
    far = np.abs(apart) > SURE * spread
    if not far.any():
        return closed
    added = np.zeros((len(fit.names), len(fit.names)))
    added[own, own] = np.where(far, apart, 0.0) ** 2
    wider = widened(fit, added)
    pulled = [(fit.names[k], -d, s) for k, d, s, f in zip(own, apart, spread, far, strict=True) if f]
    words = ", ".join(f"{n} by {d:+.2g} +- {s:.2g} {param(n).unit}" for n, d, s in pulled)
    told = most_widened(fit, wider)
    remark = f"temperatures pull {words} from where displacements have them: the added heat may have another form; intervals hold that"
    return replace(with_wider(closed, PULLED, wider), remarks=(*closed.remarks, f"{remark}, most of all {told}" if told else remark))
