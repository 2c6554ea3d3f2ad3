"""A curve of any form and the hardening law that it is added to: displacements see their sum alone, temperatures how much of it is stored.

What a law hardens by is stored, what the curve adds becomes heat. In model 2 of the thesis in monotonic flow the dissipation over Lambda is

    D = S - exp(-b Lambda) [(1 - beta) M_y0 + h alpha],   S = M_y0 + h alpha + curve,

with (4.22). Displacements give S, in MPa. A law that a wrong form has driven off gives temperatures the wrong D, and capacity, films,
conductivity and expansion follow by as much (by half, where a hardening sets in late). So the numbers of the law are fitted beside the
curve. Straight steps of all together get nowhere: the sum must stay to a hundredth of a MPa, and bends. Here the law takes its step, the
curve is what keeps the sum, and all others are fitted again. What the yield stress at no plastic strain is of the law, and what of the
curve, no datum tells: in D it stands with beta alone. The numbers that it hangs on stay.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.effects.catalogue import Effect
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.experiment.model import StageModel
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult
from thermofit.law.composition import hardening_along
from thermofit.law.hardening.catalogue import LINEAR, hardening_laws
from thermofit.law.page import law_of

POINTS = 400
"""Strains at which curves are compared."""
STEPS = 10
"""Steps of the law at most. One that stood at 1.6 and 0.43 times its numbers took five."""
FARTHEST = 1.5
"""Factor by which a number of the law changes in one step at most."""
PARTS = (1.0, 0.5, 0.25)
"""Parts of a step that are tried, until one leaves less."""
ROUNDING = 1e-9
"""Relative change of a yield stress below which it is one by rounding."""
AT_REST = 1.0
"""Fall of the objective that a step of the law promises, in units of the noise, below which it is where the data have it."""

End = tuple[Parameters, FitResult]


def curve_at(parameters: Parameters, own: Effect, largest_strain: float) -> np.ndarray:
    """What the curve adds to the yield stress, MPa (n,), from no plastic strain to the largest."""
    numbers = (parameters[n] for n in own.names)
    return np.asarray(own.act(_strains(largest_strain), 0.0, parameters["theta_ref"], law_of(parameters), *numbers))


def law_at(parameters: Parameters, largest_strain: float) -> np.ndarray:
    """Yield stress of the hardening law in monotonic flow, MPa (n,), at the same strains."""
    law = law_of(parameters)
    return np.array([hardening_along(float(strain), law)[0] for strain in _strains(largest_strain)])


def _strains(largest: float) -> np.ndarray:
    return np.linspace(0.0, largest, POINTS)


def with_the_same_sum(parameters: Parameters, there: Parameters, own: Effect, largest_strain: float) -> Parameters:
    """`there`, whose hardening law or exponents of the curve are others, with the curve that keeps the sum of both as it is by
    `parameters`, the nearest over all strains up to the largest: a fit from nothing would not come as far in the same time."""
    names = [p.name for p in own.amplitudes]
    nothing = there.replace(**dict.fromkeys(names, 0.0))
    columns = np.stack([curve_at(nothing.replace(**{n: 1.0}), own, largest_strain) for n in names], axis=1)
    wanted = curve_at(parameters, own, largest_strain) + law_at(parameters, largest_strain) - law_at(there, largest_strain)
    heights = np.linalg.lstsq(columns, wanted, rcond=None)[0]
    return there.replace(**dict(zip(names, heights.tolist(), strict=True)))


def held_law(parameters: Parameters) -> tuple[str, ...]:
    """Numbers of the hardening laws that say something of this material."""
    given = set(parameters.given())
    return tuple(dict.fromkeys(n for law in hardening_laws() for n in law.fitted if n in given and n != LINEAR))


def of_first_yield(parameters: Parameters) -> tuple[str, ...]:
    """Those that the yield stress at no plastic strain hangs on."""
    nothing = float(hardening_along(0.0, law_of(parameters))[0])
    names = held_law(parameters)
    moved = {n: hardening_along(0.0, law_of(parameters.replace(**{n: 1.01 * parameters[n] + 1e-3 * param(n).scale})))[0] for n in names}
    return tuple(n for n in names if abs(float(moved[n]) - nothing) > ROUNDING * abs(nothing))


def of_hardening(parameters: Parameters) -> tuple[str, ...]:
    """The others, where they are positive: what the law hardens by, of which temperatures tell how much is stored."""
    first = of_first_yield(parameters)
    return tuple(n for n in held_law(parameters) if n not in first and parameters[n] > 0.0)


def fitted_law(end: End, own: Effect, model: StageModel, largest_strain: float, refit: Callable[[Parameters, str], End]) -> tuple[End, str]:
    """The end of a fit with the curve, after steps of the law beside it, and what became of the law in words (empty: it is held, for
    temperatures are not fitted, or its form has no number but those of first yield). Where a run fails, the law stays where it was."""
    names = of_hardening(end[0])
    if not names or not acting_on_temperatures(end[0].free):
        return end, ""
    why = f"not settled after {STEPS} steps"
    for turn in range(STEPS):
        parameters, fit = end
        if fit.jacobian is None:
            why = f"not settled: the fit beside it has no derivatives ({fit.message})"
            break
        try:
            columns = model.linearised(parameters, names)[1]
        except NumericsError as error:
            why = f"not settled: the run of its derivatives failed ({error})"
            break
        linear = LinearModel(fit.residual, fit.jacobian).with_columns(columns)
        if fit.f - float(linear.left @ linear.left) <= AT_REST:
            why = "fitted with it"
            break
        then, failed = stepped(
            end, dict(zip(names, linear.free_step[-len(names) :].tolist(), strict=True)), own, largest_strain, refit, turn
        )
        if then is None:
            why = f"not settled: {f'steps of it cannot be run ({failed})' if failed else 'no step of it leaves less'}"
            break
        end = then
    return end, f"{', '.join(f'{n} = {end[0][n]:.4g}' for n in names)}: {why}"


def stepped(
    end: End, step: dict[str, float], own: Effect, largest_strain: float, refit: Callable[[Parameters, str], End], turn: int
) -> tuple[End | None, str]:
    """The end of the refit after the step of the law, or a part of it, that leaves less; None where none does, and why the first could not
    be run where one could not."""
    (parameters, fit), failed = end, ""
    relative = {n: d / parameters[n] for n, d in step.items()}
    share = min(1.0, np.log(FARTHEST) / max(abs(r) for r in relative.values()))
    for part in PARTS:
        there = parameters.replace(**{n: parameters[n] * float(np.exp(part * share * r)) for n, r in relative.items()})
        if any(law.error({n: there[n] for n in law.names}) for law in hardening_laws() if set(law.names) <= set(held_law(there))):
            continue
        try:
            then = refit(with_the_same_sum(parameters, there, own, largest_strain), f"{own.name} law {turn}")
        except NumericsError as error:
            failed = failed or str(error)
            continue
        if then[1].f < fit.f:
            return then, ""
    return None, failed
