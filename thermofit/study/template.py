"""The commented study file that `thermofit new` writes."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from thermofit.core.errors import StudyError
from thermofit.core.parameters import param
from thermofit.core.yaml_text import parse_yaml
from thermofit.law.hardening.catalogue import Hardening, hardening, hardening_laws
from thermofit.law.surface.catalogue import DEFAULT as DEFAULT_SURFACE
from thermofit.law.surface.catalogue import Surface, surface, surfaces
from thermofit.study.errors import near_miss
from thermofit.study.materials import MATERIALS
from thermofit.study.raw_folder import has_displacements

_TEMPLATE = """\
## A study of thermofit: which experiment, which parameters are identified, and how.
## Units: N, mm, s, K, MPa; film coefficients W/(m^2 K), kappa mW/(mm K), c0 mJ/(mm^3 K). Temperatures here are in K.
## Lines with one mark (#) show further keys, mostly with their defaults. A misspelt key is reported with the near miss.

name: my-study                       # letters, digits and _ . -
experiment: my-experiment            # raw folder, relative to this file; may hold ${VARIABLES} of the environment
# run_dir: runs/my-study             # artefacts and figures, relative to the current directory
# model: 2                           # 1: associated, linear and exponential hardening; 2: non-associated
@HARDENING@
@SURFACE@
# mesh: full                         # coarse (6 x 40 x 2), full (12 x 80 x 4) or {n_x: 12, n_y: 80, n_z: 4}; one layer: sheet (12 x 80)
# geometry: {shape: dogbone}         # bar, plate-with-hole, cruciform-arm, or file with unit and sets; look at it: `thermofit mesh`
# static: null                       # a full-field test of one load step instead of a history: field, load_axis, centre, force
# specimen: {thickness: 1.2}         # lengths in mm that replace those of experiment.yaml
# material_axes: {angle: 0}          # degrees from the load to the rolling direction of the sheet, multiple of 90

## A number is the start of an identified parameter and the value of a fixed one. What is not given is neutral:
## G = H = 0.5 and L = M = N = 1.5 (von Mises with F = 0.5), H_lin = 0. Scale: usual size of a parameter, for the search.
## Bounds say how far the search may go, not what the material is: these hold for metals in general, from lead to tungsten and spring steel.
## Starts lie between metals: put in what a handbook says of yours, and narrow bounds only where you know better than the data.
@LOOKED@
parameters:
@MEASURED@
@nu@
@YIELDS@
@alpha_exp@
@kappa@
@c0@
  beta: {start: 1.0, bounds: [0.0, 5]}         # dissipation factor (not a Taylor-Quinney factor)
  alpha_air: {start: 10, bounds: [0, 1000]}    # W/(m^2 K)
  alpha_clamp: {start: 300, bounds: [0, 1.0e+6]}
  # theta_air: 297.4                           # K; absent: thermocouples of the experiment
  # theta_clamp: 296.7
  # theta_ref: 296.7                           # absent: theta_clamp

# evaluation:
#   window: {abs_x_max: null, abs_y_max: null} # mm, nodes that are compared; null: as far as there are DIC points
#   interpolation: projection                  # or three-point (algorithms 2 and 3 of the thesis)
#   displacement_times: stages                 # or a list of times in s
#   temperature_times: frames                  # or a list of times in s
#   reference_time: null                       # s; null: first observation before loading
# force: {smoothing: phases, noise: null, drives: force}   # phases or none; N, null: estimated; or drives: crosshead, dic
# ir: {rotation_deg: null, refine: true, edge_margin: 1.0, blur: 0.0}   # landmarks: as in experiment.yaml, to replace them
# noise: {displacement: null, temperature: null}              # sigma in mm and K; null: estimated
# uncertainty: {force_class: 0.5, thickness: 0.005, width: 0.02}   # ISO 7500-1; standard uncertainties in mm; absent: taken as exact
# numerics:
#   steps_per_interval: 1
#   max_time_step: 5.0                         # s
#   plastic_integration: closed-form           # or backward-euler
#   heat_integration: sdirk2                   # or backward-euler
#   newton_tolerance: 1.0e-5                   # residual beside the forces in the body: about 1e-5 mm
#   coupling_tolerance: 1.0e-3                 # K
#   threads: 2

## channels: u, du (relative displacements), strain, theta, dtheta (change of temperature); force, stress where displacement drives.
## weight: sigma (1/sigma^2), balanced, value (2.25), max (2.26), a number, or {x: 5, y: 1} for u and du. Besides: window: {x: .., y: ..,
## t: [[t0, t1]]} that is kept, mask: [{x: .., y: ..}, {centre: .., radius: ..}, {polygon: ..}, {t: ..}] that is left out.
## window: auto (elastic range, from the data), all, or [t0, t1] in s. coupling: full or one-way.
## method: least-squares (= gauss-newton), trust-region, nelder-mead (the thesis), bobyqa, sbplx, cobyla.
stages:
@MECHANICAL@  thermal:
    free: [alpha_exp, kappa, c0, beta, alpha_air, alpha_clamp]
    channels: {dtheta: {}}
    window: all
    coupling: one-way

# literature: {E: [67000, 74000], c_p: {value: 2.43, sigma: 0.05, source: handbook}}   # shown beside what is found
# compare: {model-1: {model: 1}}               # other models of the same data, for `thermofit compare`
# experiments: {}                              # further tests by name: {other: {experiment: FOLDER, held_out: true}} is predicted
# shared: []                                  # boundary and measurement parameters that are the same in all experiments
# gridsearch:                                  # the same stage from other starts
#   stage: thermal
#   starts: [{alpha_exp: 46.0e-6}, {kappa: 400, c0: 1.22}]
#   draw: {method: latin-hypercube, number: 10, seed: 1}     # further starts, over the bounds; or sobol; within: {kappa: [50, 300]}
## quantity: a parameter that the stage does not identify, thickness (mm), clock (s added to the infrared frames), weight.u (factor).
# sensitivity: {stage: thermal, quantity: theta_clamp, values: [296.5, 296.7, 296.9]}
# effects: []                                  # effect files of your own, relative to this file: [my_effect.py]
# diagnosis:                                   # diagnose and close-loop
#   held_out: blocks                           # or phases
#   max_effects: 3
#   mesh: null                                 # null: not finer than coarse (of a sheet: 6 x 40)
#   channels: null                             # of the joint model; null: all
#   free: null                                 # its parameters; null: all that the stages identify

## necking:                                     # a necking test without force, see docs/real-necking.md
##   file: frames.csv
##   load_axis: y
##   fit_frames: [0, 40]
##   hardening_rate: 2.0                        # d ln(stress)/d(strain) of the neck at the first frame: prescribed

## Records of uniaxial coupons as testing machines export them, instead of, or besides, `experiment` above; columns by their name.
# coupon:
#   control: strain                            # what is prescribed: strain or stress
#   heat: law                                  # what heats it: law, or measured-work (of measured stress on plastic strain)
#   records:
#     - file: records/machine.xlsx           # relative to this file; ${VARIABLES} as above
#       # test: Values A                       # tag or sheet, where a file holds several
#       # where: {specimen: A 3}               # rows, where one table holds several tests
#       time: "C_1_Temps[s]"                   # or its number (1), or {column: t, unit: min}; without a time: rate: 1.0e-4 (1/s),
#                                              # along the path of the strain, or sampling_rate: 10 (rows per second)
#       strain: {extension: "C_1_Angle[mm]", gauge_length: 8.0}       # or a column, or {true_strain: e_true}; unit: "%"
#       stress: {force: "C_1_Force[kN]", diameter: 5.98}              # or area, or width and thickness, or {true_stress: ...}
#       temperature:
#         column: Temperature
#         file: records/temperature.xlsx
#         offset_s: auto                       # of its clock, from the force that both files repeat; dates: by absolute dates
#       # lateral: {column: e_t, unit: "%"}    # strain across the load; or {extension: .., width: 12.5}; contraction: positive
#       tension: negative                      # sign of the raw channels in tension
#       initial_temperature_degC: 23.8
#       # air_temperature_degC: 23.8
#       # window: [0.0, 300.0]                 # s
#       # exclude: [[10.0, 12.0]]
#       # strain_max: 0.1
#       # until: maximum-force                 # before necking
#       # jumps: [566]                         # data rows at which the extensometer slipped
#       # leave_out: [1201]                    # data rows that are not used, such as wild samples
#       # strain_zero: as-measured             # absent: strain is counted from where the elastic line meets zero stress
#       points: 2000                           # thin, turning points kept
#       # noise: {strain: 1.0e-6, stress: 0.2, temperature: 0.02, lateral: 1.0e-6}
#   series:                                    # many files alike
#     - files: [records/a.csv, records/b.csv]    # or a pattern: "records/flow_{temperature_C}C_{rate}.csv", without `each` then
#       each: {temperature_degC: [20, 300], rate: [1.0e-3, 1.0e-3]}
#       strain: {true_strain: 1}
#       stress: {true_stress: 2, unit: MPa}

## A virtual experiment instead of a measured one: take away `experiment` above.
# simulate:
#   seed: 1
#   truth: {E: 68396.66, nu: 0.34, M_y0: 128.92, M_yinf: 292.73, H_exp: 10.87, F: 0.35, alpha_exp: 20.21e-6, kappa: 133.45, c0: 2.22,
#           beta: 0.79, alpha_air: 14.72, alpha_clamp: 236.3, theta_air: 297.4, theta_clamp: 296.7}
#   mesh: full
#   specimen: {gauge_width: 25.0, thickness: 1.2, parallel_length: 100, shoulder_radius: 25, grip_width: 35,
#              total_length: 150, gripped_length: 10}
#   programme:
#     - {hold: 3.0}                            # s
#     - {crosshead_to: 9.5, rate: 0.14}        # mm, mm/s
#     - {force_to: 1500, rate: -0.14}          # N, mm/s
#     - {crosshead_to: 19.5, rate: 0.14}
#     - {force_to: 0.0, rate: -0.14}
#     - {hold_force_until: 400.0}              # s
#   machine: {compliance: 1.0e-4, slip: 0.3, rotation_deg: 0.05, drift: 0.1}   # mm/N, mm, degrees, mm
#   dic: {stages: 120, spacing: 1.0, noise_in_plane: 0.002, noise_out_of_plane: 0.005, lost_fraction: 0.01,
#         half_width: 11.5, half_height: 25.0}
#   ir: {frames: 130, pixel_size: 0.4, roll_deg: 1.1, netd: 0.025, offset: 0.5, blur_px: 0.7, landmark_noise_px: 0.15, background: 296.5,
#        background_spread: 0.15, image_shape: [218, 90]}
#   force: {rate: 10.0, noise: 4.0, crosshead_noise: 7.0e-4}   # Hz, N, mm
#   thermocouple_error: 0.05                   # K
#   max_time_step: null                        # s, while the force changes; null: that of numerics
"""

_MECHANICAL = """\
  elastic:
    free: [E, nu]
    channels: {du: {weight: sigma}}
    window: auto
    method: least-squares
    coupling: full
    max_evaluations: 2000
    tolerance: 1.0e-5
    du: {scheme: rigid-body}                   # or similarity (a uniform scale too), neighbour, gradient
    # beside: []                               # other measures whose answers are shown beside: [u, similarity]
  plastic:
    free: [@FREE@]
    channels: {du: {}}
    window: all
    coupling: full
"""
"""Stages that compare displacements."""


LookAt = Callable[[Path], "Look | str"]
"""Looks at a raw folder."""
Look = tuple[float, float, float]
"""Elastic slope and largest nominal stress in MPa, and largest strain, as a test has shown them."""
_MODEL = hardening(2)
"""The hardening law of a study that names none."""
_SURFACE = surface(DEFAULT_SURFACE)
"""The yield surface of a study that names none."""
_METALS = {"E": (1e5, 5e3, 1e6)}
"""Start and bounds of what a test shows at a first look beside hardening, for metals in general."""
_GENERAL = {"nu": (0.30, 0.05, 0.49), "alpha_exp": (15e-6, 1e-7, 1e-4), "kappa": (50.0, 1.0, 1000.0), "c0": (2.8, 0.5, 10.0)}
"""The same of what a first look does not show."""


def _of_look(look: Look, law: Hardening) -> dict[str, tuple[float, float, float]]:
    """Start and bounds by what a test has shown: E within a factor of 3 of its elastic slope; of hardening what its law says."""
    modulus, stress, strain = look
    return {"E": (modulus, modulus / 3.0, 3.0 * modulus), **law.file.search(stress, strain)}


def _line(name: str, values: tuple[float, float, float], meaning: str) -> str:
    """One parameter with start and bounds to two digits; any reader of YAML takes 1.0e+06 for a number, not 1e+06."""
    start, low, high = (re.sub(r"^(\d+)e", r"\1.0e", f"{float(f'{value:.1e}'):g}") for value in values)
    setting = f"  {name}: {{start: {start}, bounds: [{low}, {high}]}}"
    return f"{setting:<46} # {meaning}" if meaning else setting


def _surface_lines(yields: Surface) -> list[str]:
    """Lines of the Params of a yield surface: those that a fit frees with start and bounds, published ones to be put in as values."""
    if not yields.names:
        return [f"  # yield surface {yields.name}: no parameters"]
    literature, lines = getattr(yields.file, "LITERATURE", {}), []
    for name in yields.names if yields is not _SURFACE else ("F",):
        p, start = param(name), literature.get(name, param(name).neutral)
        if name in yields.fitted:
            low, high = (0.05, 5) if name == "F" else (p.lower, p.upper)
            lines.append(f"  {name}: {{start: {start:g}, bounds: [{low:g}, {high:g}]}}".ljust(47) + f"# {yields.file.MEANING[name]}")
        else:
            lines.append(f"  {name}: {start:g}".ljust(47) + f"# {yields.file.MEANING[name]}; a published value, held fixed")
    return lines


def _prescribed(names: Iterable[str], meaning: Mapping[str, str]) -> list[str]:
    """Lines of mechanical parameters that nothing measured tells: to be taken in with what is known."""
    return [f"{f'  # {name}: ...':<46} # {meaning.get(name, '')}".rstrip(" #") for name in names]


def template(
    name: str = "my-study",
    experiment: str = "my-experiment",
    look: Look | str = "no data were looked at",
    law: Hardening = _MODEL,
    material: str = "",
    yields: Surface = _SURFACE,
    displacements: bool = True,
) -> str:
    """Text of the commented study file of that name on that raw folder; it loads as it stands. `look`: what the test has shown, from which
    starts and bounds of the mechanical parameters are, or in words why it has shown nothing; `law`: that of hardening; `material`: the
    class of metals from which the others are; `yields`: the yield surface; `displacements`: False where none are measured."""
    first, second = f"name: {_quoted(name)}", f"experiment: {_quoted(experiment)}"
    own = MATERIALS[material].values if material else {}
    if isinstance(look, str):
        values = {**_METALS, **{"E": own.get("E", _METALS["E"])}, **law.file.METALS}
        said = f"## {', '.join(values)}: for {material or 'metals in general'}; {' '.join(look.split())}."
    else:
        values = _of_look(look, law)
        said = (
            f"## {', '.join(values)}: from these data at a first look, elastic slope {look[0]:.3g} MPa, largest nominal stress "
            f"{look[1]:.3g} MPa, strain {look[2]:.3g}."
        )
    if material:
        said += f"\n## nu, alpha_exp, kappa, c0: for {material}."
    surface_line = f"{'# ' if yields is _SURFACE else ''}yield_surface: {yields.name}"
    chosen = f"{'# ' if law is _MODEL else ''}hardening: {law.name}"
    laws = ", ".join(known.name for known in hardening_laws())
    meaning = {"E": "MPa", **law.file.MEANING}
    lines = "\n".join(_line(parameter, own, meaning[parameter]) for parameter, own in values.items())
    ratio, of_surface = _line("nu", own.get("nu", _GENERAL["nu"]), ""), "\n".join(_surface_lines(yields))
    if not displacements:
        said = (
            "## No displacements: the motion is computed under the measured force. Put in the mechanical parameters as numbers, from\n"
            "## another test or a handbook; they are not identified. Their errors: uncertainty: {parameters: {E: 500}}."
        )
        lines = "\n".join(_prescribed(values, meaning))
        ratio, of_surface = _prescribed(["nu"], {})[0], "\n".join(_prescribed(yields.fitted, yields.file.MEANING))
    return (
        _TEMPLATE.replace("@LOOKED@", said, 1)
        .replace("@HARDENING@", f"{chosen:<37}# instead of `model` (docs/hardening.md): {laws}", 1)
        .replace("@SURFACE@", f"{surface_line:<37}# yield surface (docs/yield-surfaces.md): {', '.join(one.name for one in surfaces())}", 1)
        .replace("@YIELDS@", of_surface, 1)
        .replace("@MECHANICAL@", _MECHANICAL if displacements else "", 1)
        .replace("@FREE@", ", ".join((*law.fitted, *yields.fitted)), 1)
        .replace("@MEASURED@", lines, 1)
        .replace("@nu@", ratio, 1)
        .replace("@alpha_exp@", _line("alpha_exp", own.get("alpha_exp", _GENERAL["alpha_exp"]), "1/K"), 1)
        .replace("@kappa@", _line("kappa", own.get("kappa", _GENERAL["kappa"]), "mW/(mm K)"), 1)
        .replace("@c0@", _line("c0", own.get("c0", _GENERAL["c0"]), "mJ/(mm^3 K), at constant elastic deformation"), 1)
        .replace("name: my-study                     ", f"{first:<35}", 1)
        .replace("experiment: my-experiment          ", f"{second:<35}", 1)
        .replace("runs/my-study  ", f"runs/{name}  ", 1)
    )


def _quoted(text: str) -> str:
    """The text as YAML takes it: plain where YAML reads that very text, else in quotes (JSON's are YAML's)."""
    plain = re.fullmatch(r"[A-Za-z_./$][A-Za-z0-9_./${}-]*", text) and parse_yaml(text, "", StudyError) == text
    return text if plain else json.dumps(text)


def write_template(
    file: Path,
    experiment: str | None = None,
    *,
    overwrite: bool = False,
    look: LookAt | None = None,
    law: str | None = None,
    material: str = "",
    yields: str = DEFAULT_SURFACE,
) -> str:
    """Write the commented study file, named after the file, on a raw folder given relative to the current directory; `look` at that folder
    says what the test shows of its material, `law` names the hardening law (model2 where none is named), `material` the class of metals,
    `yields` the yield surface. Returns in words where starts and bounds are from.

    StudyError where no hardening law or yield surface has that name, where the file exists (unless `overwrite`), where it cannot be
    written, or where the folder holds no experiment.
    """
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", file.stem) or "my-study"
    raw = "my-experiment" if experiment is None else _from_file(experiment, file)
    seen: Look | str = "no data were looked at"
    if experiment is not None and look is not None and "${" not in experiment:
        seen = look(Path(experiment).expanduser())
    if material and material not in MATERIALS:
        raise StudyError(f"--material {material} is not known{near_miss(material, MATERIALS)}; expected one of {', '.join(MATERIALS)}")
    moved = experiment is None or "${" in experiment or has_displacements(Path(experiment).expanduser())
    text = template(name, raw, seen, _MODEL if law is None else hardening(law), material, surface(yields), moved)
    try:
        with file.open("w" if overwrite else "x", encoding="utf-8") as out:
            out.write(text)
    except FileExistsError:
        raise StudyError(f"'{file}' exists and is left as it is; give another name, or --force to overwrite it") from None
    except OSError as error:
        raise StudyError(
            f"'{file}' cannot be written: {error.strerror or error}; expected the name of a file in a writable folder"
        ) from None
    if not moved:
        return "it has no displacements: put in the mechanical parameters as numbers, they are not identified"
    if isinstance(seen, str):
        return f"bounds are those of {material or 'metals in general'} ({' '.join(seen.split())})"
    tail = f", those of heat for {material}" if material else ""
    return f"bounds by the elastic slope {seen[0]:.3g} MPa and the largest stress {seen[1]:.3g} MPa of the data{tail}"


def _from_file(experiment: str, file: Path) -> str:
    """The raw folder as the study file names it: relative to the file; with ${VARIABLES} or absolute, as given."""
    if "${" in experiment:
        return experiment
    folder = Path(experiment).expanduser()
    if not (folder / "experiment.yaml").is_file():
        raise StudyError(f"'{experiment}' holds no experiment.yaml; expected the raw folder of an experiment, see docs/formats.md")
    return str(folder) if folder.is_absolute() else Path(os.path.relpath(folder, file.parent)).as_posix()
