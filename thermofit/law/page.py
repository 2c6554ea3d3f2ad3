"""The law page: what the material is, one scalar function per physical statement (thesis chapter 4).

Free energy (4.1) to (4.7), per unit reference volume, theta_0 the stress-free reference temperature:

    psi = lambda/2 ln^2 J + mu/2 (tr C_el - 3) - mu ln J                     elastic (4.2)
        + c0 [theta - theta_0 - theta ln(theta/theta_0)]                     thermal (4.3)
        - 3 alpha_exp K (theta - theta_0) ln J / J                           coupling (4.4)
        + (1 - beta) M_y0 alpha                                              stored energy of cold work (4.5)
        + psi_pl(alpha)                                                      hardening (4.6), (4.7)

Plastic flow is isochoric, so J = det F = det F_el. Isotropic elasticity: M = F_el^T P_el is symmetric and its deviator is
mu dev C_el; the yield surface, Hill's (4.19) or another one of law.surface, sees nothing else of it.

The yield stress over alpha, and psi_pl with it, is that of a hardening law, one file each in law.hardening: `model` selects it. All are
associated, alpha = Lambda, but for model 2 of the thesis. Linear hardening, H_lin Lambda, is added to any of them.
"""

from __future__ import annotations

from collections import namedtuple
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.jit import by_type, kernel
from thermofit.core.parameters import Parameters, param
from thermofit.core.slots import Slots
from thermofit.effects.linear_hardening import yield_stress as linear_hardening
from thermofit.law.composition import (
    AMPLITUDES,
    EFFECT_NUMBERS,
    EFFECT_PARAMS,
    added_yield_stress,
    dissipation_factor,
    hardening_alpha,
    hardening_energy,
    hardening_heat,
    hardening_stress,
    restructured,
    stored_yield_stress,
    yield_factor,
)
from thermofit.law.hardening.catalogue import SHARED, hardening
from thermofit.law.surface.catalogue import DEFAULT, HILL, surface
from thermofit.law.surface.catalogue import NUMBERS as OF_SURFACE
from thermofit.law.tensor import Symmetric
from thermofit.law.transformed import axial_gradient


class BaseLaw(NamedTuple):
    """Numbers of the law as the kernels take them; units as in `core.parameters`, moduli in MPa. Those of effects follow in `Law`, whose
    hardening law is one of the thesis and whose yield surface is quadratic. Any other hardening makes it an `AnyLaw`, any other surface a
    `SurfaceLaw`, both an `AnySurfaceLaw`: these have numbers of their own before `model`, and the last two end with the number of the
    `surface`. Kernels are compiled for each of them when one is used."""

    lame: float
    mu: float
    bulk: float
    M_y0: float
    M_yinf: float
    H_exp: float
    H_lin: float
    F: float
    G: float
    H: float
    L: float
    M: float
    N: float
    alpha_exp: float
    kappa: float
    c0: float
    beta: float
    theta_ref: float
    model: int
    """Number of the hardening law (law.hardening): 1 and 2 are the models of the thesis."""
    closed_form: int
    """1: alpha integrated in closed form (errata 2); 0: backward Euler as in the thesis."""
    plastic: int
    """0: plasticity never starts (identification of the elastic stage)."""
    effective: int
    """1: at least one effect is on (or asked for its influence); 0: none is looked at."""
    per_second: float
    """1 / dt of the step in 1/s: rate of Lambda = dLambda / dt."""


if TYPE_CHECKING:
    Law = BaseLaw
    AnyLaw = BaseLaw
    SurfaceLaw = BaseLaw
    AnySurfaceLaw = BaseLaw
else:
    _FLAGS = BaseLaw._fields.index("model")
    _NUMBERS, _LAST = BaseLaw._fields[:_FLAGS], BaseLaw._fields[_FLAGS:]
    Law = namedtuple("Law", (*_NUMBERS, *_LAST, *EFFECT_NUMBERS))
    AnyLaw = namedtuple("AnyLaw", (*_NUMBERS, *SHARED, *_LAST, *EFFECT_NUMBERS))
    SurfaceLaw = namedtuple("SurfaceLaw", (*_NUMBERS, *OF_SURFACE, *_LAST, "surface", *EFFECT_NUMBERS))
    AnySurfaceLaw = namedtuple("AnySurfaceLaw", (*_NUMBERS, *SHARED, *OF_SURFACE, *_LAST, "surface", *EFFECT_NUMBERS))


def law_of(parameters: Parameters, model: int | str | Slots = 2, *, closed_form: bool = True, plastic: bool = True) -> Law:
    """The Law of named parameters: lambda, mu, K from E and nu (Remark 4.5); `model` is the hardening law, by number or name, or says which
    yield surface is taken as well. Hill's constants that a quadratic surface does not have are neutral, as they are beside another one.
    StudyError where there is none of that name."""
    slots = model if isinstance(model, Slots) else Slots(model)
    yields = surface(slots.surface)
    v = {**parameters.values, **{name: param(name).neutral for name in HILL if name not in yields.names}}
    E, nu = v["E"], v["nu"]
    lame = E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    mu = E / (2.0 * (1.0 + nu))
    names = ("M_y0", "M_yinf", "H_exp", "H_lin", "F", "G", "H", "L", "M", "N", "alpha_exp", "kappa", "c0", "beta", "theta_ref")
    of_effects: dict[str, Any] = dict(zip(EFFECT_NUMBERS, (parameters[name] for name in EFFECT_PARAMS), strict=True))
    selected = hardening(slots.hardening)
    own = selected.own_values(parameters)
    kind: Any = (Law if selected.small else AnyLaw) if yields.quadratic else (SurfaceLaw if selected.small else AnySurfaceLaw)
    of_surface = (
        {} if yields.quadratic else {**dict(zip(OF_SURFACE, yields.number_values(parameters), strict=True)), "surface": yields.number}
    )
    made: Law = kind(
        lame=lame,
        mu=mu,
        bulk=lame + 2.0 * mu / 3.0,
        model=selected.number,
        closed_form=int(closed_form),
        plastic=int(plastic),
        effective=int(any(parameters[name] != param(name).neutral for name in AMPLITUDES)),
        per_second=0.0,
        **{name: v[name] for name in names},
        **({} if selected.small else dict(zip(SHARED, (*own, *(0.0,) * (len(SHARED) - len(own))), strict=True))),
        **of_surface,
        **of_effects,
    )
    return made


def slots_of(law: Law) -> Slots:
    """What stands in the slots of a law, by number. All quadratic surfaces are Hill's there."""
    return Slots(law.model, getattr(law, "surface", DEFAULT))


def law_in_step(law: Law, dt: float) -> Law:
    """The law in a step of dt s: the rate of plastic flow is dLambda / dt."""
    return law._replace(per_second=1.0 / dt)


def in_model_axes(parameters: Parameters, angle: float, model: int | str | Slots = 2) -> Parameters:
    """Parameters of the same sheet with respect to x, y, z where its axes are turned by quarter turns `angle` (degrees) about z.

    Axes 1 and 2 change places: of Hill's surface G with H, M with N (4.19); `model` says which surface it is, as in `law_of`. The
    parameters themselves at even multiples. StudyError for another angle.
    """
    if angle % 90.0 != 0.0:
        raise StudyError(f"material axes: an angle of {angle:g} degrees found; only multiples of 90 exchange the parameters of the surface")
    if angle % 180.0 == 0.0:
        return parameters
    yields = surface(model.surface if isinstance(model, Slots) else DEFAULT)
    return parameters.replace(**yields.turned({name: parameters[name] for name in yields.names}))


def along_tension(parameters: Parameters, model: int | str | Slots = 2) -> tuple[float, float]:
    """Of uniaxial tension along y: plastic strain over Lambda, which is sigma_y over the stress as well, and the share -(strain across x)
    of it. Of Hill's surface sqrt(F + H) and F / (F + H). The parameters are in the axes of the model."""
    n_x, n_y, _ = surface_gradient(0.0, 1.0, 0.0, law_of(parameters, model))
    return float(np.sqrt(n_y)), float(-n_x / n_y)


@kernel(inline="always")
def hardening_variable(alpha_n: float, d_lambda: float, law: Law) -> tuple[float, float]:
    """alpha after the plastic increment d_lambda, and d alpha / d d_lambda (4.15): alpha_n + d_lambda but for model 2."""
    found: tuple[float, float] = hardening_alpha(alpha_n, d_lambda, law)
    return found


@kernel(inline="always")
def yield_stress(alpha: float, accumulated: float, law: Law) -> tuple[float, float, float]:
    """Yield stress M_y0 - K_bar in MPa, and its derivatives by alpha and by the accumulated multiplier Lambda (4.18), (4.29)."""
    value, by_alpha = hardening_stress(alpha, law)
    return value + linear_hardening(accumulated, law.H_lin), by_alpha, law.H_lin


@kernel(inline="always")
def yield_stress_at_rate(alpha: float, accumulated: float, rate: float, theta: float, law: Law) -> float:
    """Yield stress in MPa with all effects, (base + sum of terms) * product of factors, at the rate of Lambda in 1/s and theta K."""
    value = yield_stress(alpha, accumulated, law)[0]
    if law.effective == 0:
        return value
    return (value + added_yield_stress(accumulated, rate, theta, law)) * yield_factor(accumulated, rate, theta, law)


_NEAR, _SHARE = 1e-13, 1e-5
"""Increment of Lambda over which the slope of effects is taken: absolute, and relative to that of the step. An overstress rises within
rate times step, which is 1e-10 for slow rates and short steps; a longer reach takes too small a slope, and Newton goes to and fro."""


@kernel(inline="always")
def flow_stress(alpha: float, accumulated: float, d_lambda: float, theta: float, law: Law) -> tuple[float, float, float]:
    """Yield stress with all effects: (base + sum of terms) * product of factors, MPa, at the rate d_lambda / dt and theta K.

    Then its derivatives by alpha, and by Lambda and d_lambda together; the latter, of effects, by a difference: it guides Newton only.
    """
    value, by_alpha, by_lambda = yield_stress(alpha, accumulated, law)
    if law.effective == 0:
        return value, by_alpha, by_lambda
    rate = d_lambda * law.per_second
    total = (value + added_yield_stress(accumulated, rate, theta, law)) * yield_factor(accumulated, rate, theta, law)
    h = _NEAR + _SHARE * d_lambda
    more, faster = accumulated + h, (d_lambda + h) * law.per_second
    factor = yield_factor(more, faster, theta, law)
    ahead = (value + by_lambda * h + added_yield_stress(more, faster, theta, law)) * factor
    return total, by_alpha * factor, (ahead - total) / h


@kernel(inline="always")
def released_energy(alpha_n: float, alpha: float, d_lambda: float, accumulated: float, theta: float, law: Law) -> float:
    """Mechanical dissipation of one increment with all effects, mJ/mm^3; `accumulated` and theta at its end.

    To that of the base law comes what the effects add to the yield stress times d_lambda, less what their hardening stores; then the
    factors of slot dissipation.
    """
    base = dissipated_energy(alpha_n, alpha, d_lambda, law)
    if law.effective == 0:
        return base
    rate = d_lambda * law.per_second
    plain, _, _ = yield_stress(alpha, accumulated, law)
    added = added_yield_stress(accumulated, rate, theta, law)
    total = (plain + added) * yield_factor(accumulated, rate, theta, law)
    extra = (total - plain - stored_yield_stress(accumulated, rate, theta, law)) * d_lambda
    return (base + extra) * dissipation_factor(accumulated, rate, theta, law)


@kernel(inline="always")
def dissipated_energy(alpha_n: float, alpha: float, d_lambda: float, law: Law) -> float:
    """Mechanical dissipation of one increment of the base law in mJ/mm^3: the integral of (4.21) or (4.22) over d_lambda."""
    released: float = hardening_heat(alpha_n, alpha, d_lambda, law)
    return released


@kernel(inline="always")
def pressure_factor(log_j: float, j: float, theta: float, law: Law) -> tuple[float, float]:
    """k in P = mu F C_p^-1 + k F^-T (4.8), MPa, and dk / d ln J: k = lambda ln J - mu - 3 alpha K (theta - theta_0)(1 - ln J)/J."""
    thermal = 3.0 * law.alpha_exp * law.bulk * (theta - law.theta_ref) / j
    return law.lame * log_j - law.mu - thermal * (1.0 - log_j), law.lame + thermal * (2.0 - log_j)


@kernel(inline="always")
def thermoelastic_heat(theta: float, g_n: float, g: float, law: Law) -> float:
    """Gough-Joule heat of one increment, mJ/mm^3 (4.20): theta d2psi/dF_el dtheta : dF_el = -3 alpha K theta d(ln J / J).

    g = ln J / J at the end, g_n at the start of the increment.
    """
    return -3.0 * law.alpha_exp * law.bulk * theta * (g - g_n)


@kernel(inline="always")
def hill_gradient(a11: float, a22: float, a33: float, law: Law) -> tuple[float, float, float]:
    """Normal components of G : A for the Hill tensor (4.19), (D.7): F acts on (11-22), G on (33-11), H on (22-33)."""
    f = law.F * (a11 - a22)
    g = law.G * (a33 - a11)
    h = law.H * (a22 - a33)
    return f - g, h - f, g - h


def is_transformed(law: Law) -> bool:
    """Whether the surface of a law is one of law.transformed, not a quadratic one."""
    return hasattr(law, OF_SURFACE[0])


def surface_gradient(a11: float, a22: float, a33: float, law: Law) -> tuple[float, float, float]:
    """Normal components of phi dphi/dS at a stress without shear: G : S of a quadratic surface. phi^2 is their product with the stress.

    In kernels and outside them; the type of the law says which kind of surface it has.
    """
    of_type: Any = axial_gradient if is_transformed(law) else hill_gradient
    found: tuple[float, float, float] = of_type(a11, a22, a33, law)
    return found


def transformed(law: Any) -> bool:
    """Of numba's type of a law: whether its surface is one of law.transformed."""
    return OF_SURFACE[0] in law.fields


@by_type(surface_gradient)
def _surface_gradient(a11: Any, a22: Any, a33: Any, law: Any) -> Any:
    if transformed(law):
        return lambda a11, a22, a33, law: axial_gradient(a11, a22, a33, law)
    return lambda a11, a22, a33, law: hill_gradient(a11, a22, a33, law)


def relative(law: Law) -> bool:
    """Whether the local update is that of `point.lanes_relative`: an effect is on that changes it, or the surface is not quadratic. In
    kernels and outside them."""
    return is_transformed(law) or bool(law.effective == 1 and restructured(law))


@by_type(relative)
def _relative(law: Any) -> Any:
    if transformed(law):
        return lambda law: True
    return lambda law: law.effective == 1 and restructured(law)


@kernel(forceinline=True)
def hill(a: Symmetric, law: Law) -> Symmetric:
    """G : A for the Hill tensor of (4.19), (D.7)."""
    g11, g22, g33 = hill_gradient(a[0], a[1], a[2], law)
    return (g11, g22, g33, law.L * a[3], law.M * a[4], law.N * a[5])


@kernel(inline="always")
def plastic_energy(alpha: float, accumulated: float, law: Law) -> float:
    """Energy stored by plastic flow in mJ/mm^3: (1 - beta) M_y0 alpha (4.5) and hardening psi_pl (4.6), (4.7), zero at alpha = 0.

    The linear hardening is H_lin Lambda^2 / 2 with any law.
    """
    return (1.0 - law.beta) * law.M_y0 * alpha + hardening_energy(alpha, law) + 0.5 * law.H_lin * accumulated * accumulated


@kernel(inline="always")
def elastic_energy(trace: float, log_j: float, law: Law) -> float:
    """Elastic part of the free energy in mJ/mm^3 (4.2); trace = tr C_el."""
    return 0.5 * law.lame * log_j * log_j + 0.5 * law.mu * (trace - 3.0) - law.mu * log_j


@kernel(inline="always")
def free_energy(trace: float, log_j: float, j: float, theta: float, alpha: float, accumulated: float, law: Law) -> float:
    """psi in mJ/mm^3 (4.1) to (4.7); trace = tr C_el, log_j = ln J, theta in K."""
    thermal = law.c0 * (theta - law.theta_ref - theta * np.log(theta / law.theta_ref))
    coupling = -3.0 * law.alpha_exp * law.bulk * (theta - law.theta_ref) * log_j / j
    return elastic_energy(trace, log_j, law) + thermal + coupling + plastic_energy(alpha, accumulated, law)


@kernel(inline="always")
def entropy(log_j: float, j: float, theta: float, law: Law) -> float:
    """eta = -d psi / d theta in mJ/(mm^3 K), from (4.3) and (4.4)."""
    return law.c0 * np.log(theta / law.theta_ref) + 3.0 * law.alpha_exp * law.bulk * log_j / j


@kernel(inline="always")
def internal_energy(trace: float, log_j: float, j: float, theta: float, alpha: float, accumulated: float, law: Law) -> float:
    """e = psi + theta eta in mJ/mm^3, from (4.1) to (4.7); arguments as in `free_energy`.

    Of the coupling (4.4) there remains 3 alpha_exp K theta_0 ln J / J, of the thermal part (4.3) c0 (theta - theta_0).
    """
    coupling = 3.0 * law.alpha_exp * law.bulk * law.theta_ref * log_j / j
    thermal = law.c0 * (theta - law.theta_ref)
    return elastic_energy(trace, log_j, law) + thermal + coupling + plastic_energy(alpha, accumulated, law)
