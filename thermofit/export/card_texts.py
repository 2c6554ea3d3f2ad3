"""Material cards as text: Abaqus, CalculiX, LS-DYNA, MFront, YAML. Units N, mm, s, K, t (stress in MPa, mW = N mm/s).

Every card begins with what it rests on: range of the test, effects, what it cannot hold. Conventions of the programmes: Abaqus 2023,
Materials, 23.2.6 (POTENTIAL: ratios of yield stresses, those of shear by sqrt(3)); LS-DYNA Manual II (fields of ten columns);
MFront, documentation of the brick StandardElastoViscoPlasticity and of its stress potential Hooke in TFEL (Hill after Lemaitre and
Chaboche: F (11-22), G (22-33), H (33-11), L (12), M (13), N (23); hardening by points: Data; E, nu and expansion without a number hold for
orthotropic behaviours too).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping

import yaml

from thermofit import __version__
from thermofit.core.jsonable import jsonable
from thermofit.export.card import Card, FlowCurve
from thermofit.law.surface.catalogue import COEFFICIENTS, HILL, surface

DENSITY = 1e-9
"""t/mm^3, written where none is given: of heat only the product with the specific heat counts."""
_CONSTANTS = ("E", "nu", "F", "G", "H", "L", "M", "N", "alpha_exp", "kappa", "c0", "beta")
"""What a card holds of the base law besides its yield curve."""
_FIRST_ID = 1001


def remarks_of(card: Card, density: float | None) -> list[str]:
    """What every card says first, a line each."""
    v = card.visited
    lines = [
        f"{card.name}, identified by thermofit {__version__}; units N, mm, s, K, t (MPa, mW/(mm K))",
        f"hardening {card.law}: {card.formula}",
        *_surface_lines(card),
        f"range of validity: plastic strain up to {v.strain:.4g} ({v.source}),",
        f"  plastic strain rate {v.rate[0]:.3g} to {v.rate[1]:.3g} 1/s, temperature {v.temperature[0]:.2f} to {v.temperature[1]:.2f} K",
        f"  stresses at plastic strains above {v.strain:.4g} are extrapolated by the law",
        "yield stress: Cauchy stress over logarithmic plastic strain along axis 2 (rolling direction)",
    ]
    if card.angle:
        lines.append(f"axis 2 of the sheet lies {card.angle:g} degrees from the load of the test, about the thickness axis 3")
    for effect in card.effects:
        values = ", ".join(f"{name} = {value:.6g}" for name, value in effect.values.items())
        lines.append(f"effect {effect.name} {'is in this card' if effect.held else 'IS NOT IN THIS CARD'}: {effect.formula}; {values}")
    if not card.effects:
        lines.append("effects: none beside the base law")
    held = [name for name in _CONSTANTS if card.transformed is None or name not in HILL]
    if given := [f"{name} = {card.parameters[name]:.6g}" for name in held if name not in card.sigma]:
        lines.append(f"not identified, as the study gives them: {', '.join(given)}")
    lines.append(f"specific heat: that of constant stress, {card.capacity:.6g} mJ/(mm^3 K) over the density")
    lines.append(
        f"heat: {card.heat_share:.4g} of the plastic work up to that strain; dissipation factor beta = {card.parameters['beta']:.6g}"
    )
    if density is None:
        lines.append(f"density was not identified: {DENSITY:g} t/mm^3 stands for it; put yours in and scale the specific heat against it")
    return lines


def _commented(lines: Iterable[str], sign: str) -> list[str]:
    return [f"{sign} {line}" for line in lines]


def _surface_lines(card: Card) -> list[str]:
    """Name, formula and values of a surface that is not quadratic, in lines that every programme reads."""
    if card.transformed is None:
        return []
    values = [f"{name.partition('.')[2]} = {card.parameters[name]:.6g}" for name in surface(card.surface).names]
    lines = [f"yield surface {card.surface}: {card.surface_formula}"]
    return [*lines, *(f"  {', '.join(values[k : k + 6])}" for k in range(0, len(values), 6))]


def _isotropic_only(card: Card) -> list[str]:
    """Told where a programme's card takes the surface of von Mises and the identified one is another."""
    if card.isotropic:
        return []
    if card.transformed is not None:
        return [f"this card yields by von Mises: right along axis 2 alone; the identified surface is {card.surface}"]
    f, g, h, *_ = card.hill
    return [
        f"this card yields by von Mises: right along axis 2, not across; identified Hill F = {f:.6g}, G = {g:.6g}, H = {h:.6g} (F + H = 1)"
    ]


def _one_curve_only(card: Card) -> list[str]:
    """Told where a programme's card takes one rate and one temperature and the law depends on them."""
    if len(card.curves) == 1:
        return []
    c = card.reference
    return [f"this card holds one curve, at {c.rate:.3g} 1/s and {c.theta:.2f} K: the identified law depends on them"]


def ratios(card: Card) -> tuple[float, float, float, float, float, float]:
    """R11, R22, R33, R12, R13, R23: yield stresses over that along axis 2, of shear times sqrt(3)."""
    f, g, h, of_12, of_23, of_13 = card.hill
    shear = [math.sqrt(1.5 / value) for value in (of_12, of_13, of_23)]
    return 1.0 / math.sqrt(f + g), 1.0 / math.sqrt(f + h), 1.0 / math.sqrt(g + h), shear[0], shear[1], shear[2]


def _rows(curve: FlowCurve, *more: float) -> Iterator[str]:
    """stress, strain lines, with further columns behind."""
    tail = "".join(f", {value:.6g}" for value in more)
    return (f"{stress:.8g}, {strain:.8g}{tail}" for stress, strain in zip(curve.stress, curve.strain, strict=True))


def _material_name(card: Card) -> str:
    return "".join(sign if sign.isalnum() else "_" for sign in card.name).upper()[:60]


def _elastic(card: Card) -> list[str]:
    """Lines E, nu below *ELASTIC, with the temperature behind where E changes with it."""
    several = len(card.moduli) > 1
    return [f"{young:.8g}, {card.parameters['nu']:.8g}" + (f", {theta:.6g}" if several else "") for theta, young in card.moduli]


def _one_modulus_only(card: Card) -> list[str]:
    """Told where a programme's card takes one Young's modulus and the identified one changes with temperature."""
    if len(card.moduli) == 1:
        return []
    return [f"this card holds E at {card.reference.theta:.2f} K: the identified one changes with temperature"]


def _abaqus_heat(card: Card, density: float) -> list[str]:
    p = card.parameters
    return [
        f"*EXPANSION, ZERO={p['theta_ref']:.8g}",
        f"{p['alpha_exp']:.8g},",
        "*CONDUCTIVITY",
        f"{p['kappa']:.8g},",
        "*DENSITY",
        f"{density:.8g},",
        "*SPECIFIC HEAT",
        f"{card.capacity / density:.8g},",
    ]


def abaqus(card: Card, density: float | None = None) -> str:
    """*MATERIAL with *PLASTIC by rate and temperature, *POTENTIAL for Hill, *INELASTIC HEAT FRACTION."""
    told = _isotropic_only(card) if card.transformed is not None else []
    lines = [*_commented([*remarks_of(card, density), *told], "**"), f"*MATERIAL, NAME={_material_name(card)}", "*ELASTIC"]
    lines += _elastic(card)
    for rate in dict.fromkeys(c.rate for c in card.curves):
        at_rate = [c for c in card.curves if c.rate == rate]
        lines.append(f"*PLASTIC, RATE={rate:.6g}" if card.of_rates else "*PLASTIC")
        for curve in at_rate:
            lines += _rows(curve, *((curve.theta,) if card.of_temperatures else ()))
    if not card.isotropic and card.transformed is None:
        lines += ["*POTENTIAL", ", ".join(f"{value:.8g}" for value in ratios(card))]
    lines += _abaqus_heat(card, density or DENSITY)
    lines += ["*INELASTIC HEAT FRACTION", f"{card.heat_share:.6g},"]
    return "\n".join(lines) + "\n"


def calculix(card: Card, density: float | None = None) -> str:
    """*MATERIAL with *PLASTIC by temperature; CalculiX yields by von Mises and knows neither rates nor heat of plastic work there."""
    told = [*_isotropic_only(card), *(_one_curve_only(card) if card.of_rates else ())]
    lines = [*_commented([*remarks_of(card, density), *told], "**"), f"*MATERIAL, NAME={_material_name(card)}", "*ELASTIC"]
    lines += _elastic(card)
    lines.append("*PLASTIC")
    if card.of_temperatures:
        for curve in (c for c in card.curves if c.rate == card.reference.rate):
            lines += _rows(curve, curve.theta)
    else:
        lines += _rows(card.reference)
    return "\n".join([*lines, *_abaqus_heat(card, density or DENSITY)]) + "\n"


def _fields(*values: float | int | str) -> str:
    """One line of fields of ten columns."""
    return "".join(
        value.rjust(10) if isinstance(value, str) else f"{value:>10d}" if isinstance(value, int) else f"{value:>10.4g}" for value in values
    )


def ls_dyna(card: Card, density: float | None = None) -> str:
    """*MAT_024 with a curve, or a table over rates, of yield stress; *MAT_THERMAL_ISOTROPIC and the expansion beside it."""
    p, rho = card.parameters, density or DENSITY
    theta = card.reference.theta
    curves = [c for c in card.curves if c.theta == theta]
    told = [*_isotropic_only(card), *_one_modulus_only(card)]
    if card.of_temperatures:
        told.append(f"this card holds the temperature {theta:.2f} K: the identified law depends on it")
    first = _FIRST_ID + 1
    lines = [
        *_commented([*remarks_of(card, density), *told], "$"),
        "*KEYWORD",
        "*MAT_PIECEWISE_LINEAR_PLASTICITY_TITLE",
        _material_name(card),
        "$      MID        RO         E        PR      SIGY      ETAN      FAIL      TDEL",
        _fields(_FIRST_ID, rho, card.young, p["nu"], float(curves[0].stress[0]), 0.0, 0.0, 0.0),
        "$        C         P      LCSS      LCSR        VP",
        _fields(0.0, 0.0, _FIRST_ID if card.of_rates else first, 0, 1.0),
        _fields(*(0.0,) * 8),
        _fields(*(0.0,) * 8),
    ]
    if card.of_rates:
        lines += ["*DEFINE_TABLE_2D", "$     TBID", _fields(_FIRST_ID), "$               RATE                LCID"]
        lines += [f"{c.rate:>20.8g}{first + n:>20d}" for n, c in enumerate(curves)]
    for n, curve in enumerate(curves):
        lines += ["*DEFINE_CURVE", "$     LCID", _fields(first + n), "$     PLASTIC STRAIN        YIELD STRESS"]
        lines += [f"{x:>20.8g}{y:>20.8g}" for x, y in zip(curve.strain, curve.stress, strict=True)]
    lines += [
        "*MAT_THERMAL_ISOTROPIC",
        "$     TMID       TRO     TGRLC    TGMULT",
        _fields(_FIRST_ID, rho, 0.0, 0.0),
        "$       HC        TC",
        _fields(card.capacity / rho, p["kappa"]),
        "$ expansion belongs to a part: put its number for PID; FWORK of *CONTROL_THERMAL_SOLVER is the share of plastic work that heats",
        f"$ *CONTROL_THERMAL_SOLVER, FWORK = {card.heat_share:.6g}",
        "$ *MAT_ADD_THERMAL_EXPANSION",
        "$      PID      LCID      MULT",
        "$" + _fields("PID", 0, p["alpha_exp"])[1:],
        "*END",
    ]
    return "\n".join(lines) + "\n"


_MFRONT = ("12", "21", "13", "31", "23", "32", "66", "55", "44")
"""Order of the coefficients of a transformation in MFront's criterion Barlat (TFEL, StandardElastoViscoPlasticity)."""


def _mfront_criterion(card: Card) -> list[str]:
    """Hill's criterion, or Barlat's with an exponent and two transformations."""
    if card.transformed is None:
        f, g, h, of_12, of_23, of_13 = card.hill
        return [
            "    // F (11-22)^2 + G (22-33)^2 + H (33-11)^2 + 2 L (12)^2 + 2 M (13)^2 + 2 N (23)^2",
            f'    criterion : "Hill" {{F : {f:.8g}, G : {h:.8g}, H : {g:.8g}, L : {of_12:.8g}, M : {of_13:.8g}, N : {of_23:.8g}}},',
        ]
    a, *c = card.transformed
    first, second = (dict(zip(COEFFICIENTS, part, strict=True)) for part in (c[:9], c[9:]))
    l1, l2 = (", ".join(f"{part[at]:.8g}" for at in _MFRONT) for part in (first, second))
    return [
        f"    // {card.surface}; coefficients of 12, 21, 13, 31, 23, 32 and of the shears 12, 13, 23",
        f'    criterion : "Barlat" {{a : {a:.8g}, l1 : {{{l1}}},',
        f"      l2 : {{{l2}}}}},",
    ]


def mfront(card: Card, density: float | None = None) -> str:
    """A behaviour of the brick StandardElastoViscoPlasticity with the surface and the curve as data; for logarithmic strains."""
    p, curve = card.parameters, card.reference
    data = ", ".join(f"{x:.8g} : {y:.8g}" for x, y in zip(curve.strain, curve.stress, strict=True))
    name = "".join(part.capitalize() for part in _material_name(card).lower().split("_")) or "Material"
    lines = [
        *_commented([*remarks_of(card, density), *_one_curve_only(card), *_one_modulus_only(card)], "//"),
        "@DSL Implicit;",
        f"@Behaviour {name if name[0].isalpha() else 'M' + name};",
        "@StrainMeasure Hencky;",
        "@OrthotropicBehaviour;",
        "@Epsilon 1.e-14;",
        "@Theta 1;",
        "@Brick StandardElastoViscoPlasticity{",
        f'  stress_potential : "Hooke" {{young_modulus : {card.young:.8g}, poisson_ratio : {p["nu"]:.8g},',
        f"    thermal_expansion : {p['alpha_exp']:.8g}, thermal_expansion_reference_temperature : {p['theta_ref']:.8g}}},",
        '  inelastic_flow : "Plastic" {',
        *_mfront_criterion(card),
        f'    isotropic_hardening : "Data" {{values : {{{data}}}, interpolation : "linear"}}',
        "  }",
        "};",
        f"// conductivity {p['kappa']:.8g} mW/(mm K)",
    ]
    return "\n".join(lines) + "\n"


def _yaml_surface(card: Card) -> dict[str, object]:
    """Constants of the surface, which yields at the table's stress along axis 2."""
    if card.transformed is None:
        return {
            "hill": dict(zip("FGHLMN", card.hill, strict=True))
            | {"meaning": "F (11-22)^2 + G (33-11)^2 + H (22-33)^2 + 2 L (12)^2 + 2 M (23)^2 + 2 N (13)^2; F + H = 1"},
            "yield_ratios": dict(zip(("R11", "R22", "R33", "R12", "R13", "R23"), ratios(card), strict=True)),
        }
    a, *c = card.transformed
    parts = {f"c{n}": dict(zip(COEFFICIENTS, part, strict=True)) for n, part in ((1, c[:9]), (2, c[9:]))}
    meaning = (
        f"{card.surface_formula}; coefficients in the axes 1 (width), 2 (rolling), 3 (thickness), phi = stress of tension along axis 2"
    )
    return {"yield_surface": {"name": card.surface, "a": a, **parts, "meaning": meaning}}


def plain_yaml(card: Card, density: float | None = None) -> str:
    """Everything in plain YAML, with standard errors and units."""
    v, p = card.visited, card.parameters
    content = {
        "material": card.name,
        "made_by": f"thermofit {__version__}",
        "units": "N, mm, s, K, t; stress MPa, conductivity mW/(mm K), heat capacity mJ/(mm^3 K)",
        "remarks": remarks_of(card, density)[2:],
        "parameters": {name: {"value": value, "sigma": card.sigma.get(name)} for name, value in p.values.items()},
        "young_modulus": [{"temperature_K": theta, "E_MPa": young} for theta, young in card.moduli],
        "hardening": {"law": card.law, "formula": card.formula},
        **_yaml_surface(card),
        "density": density,
        "heat_capacity_at_constant_stress": card.capacity,
        "share_of_plastic_work_that_heats": card.heat_share,
        "range_of_validity": {
            "plastic_strain": [0.0, v.strain],
            "strain_of": v.source,
            "rate_per_s": v.rate,
            "temperature_K": v.temperature,
        },
        "effects": [{"name": e.name, "formula": e.formula, "parameters": dict(e.values), "in_table": e.held} for e in card.effects],
        "yield_curves": [
            {"rate_per_s": c.rate, "temperature_K": c.theta, "plastic_strain": c.strain, "yield_stress_MPa": c.stress} for c in card.curves
        ],
    }
    return yaml.safe_dump(jsonable(content), sort_keys=False, width=120)


CARDS: Mapping[str, tuple[str, Callable[[Card, float | None], str]]] = {
    "abaqus": ("abaqus.inp", abaqus),
    "calculix": ("calculix.inp", calculix),
    "ls-dyna": ("ls-dyna.k", ls_dyna),
    "mfront": ("mfront.mfront", mfront),
    "yaml": ("material.yaml", plain_yaml),
}
"""File and writer of every card."""
