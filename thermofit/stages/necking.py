"""`necking`: the hardening law from equal force through all cross-sections of a necking specimen; no force, time or scale is needed."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Any

import matplotlib
import numpy as np

from thermofit.core.errors import DataError, StudyError
from thermofit.identify.necking import (
    BOUNDS,
    HardeningLaw,
    NeckingFit,
    Onset,
    SectionStrains,
    contraction,
    fit_sections,
    held_out,
    neck_shape,
    onset,
    other_rates,
    predicted,
    sections_of,
)
from thermofit.read.section_strain import read_grid, section_strain
from thermofit.records.artefact import Dataset, ParameterResult
from thermofit.records.staging import Made, Outcome, job, produce
from thermofit.report.figures import STYLE, save_figures
from thermofit.report.figures_necking import NeckingPicture, necking_figure
from thermofit.study.models import Necking
from thermofit.study.study import Study

NAME = "necking"
BEYOND = 2.0
"""Considere strain and localisation disagree beyond this many standard errors."""


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record with law, strains and predictions, and `<run_dir>/necking.png`. StudyError without the section `necking`."""
    if study.necking is None or study.necking_file is None:
        raise StudyError(f"{study.source.name}: key 'necking' is missing: name the displacements of the grid, see docs/real-necking.md")
    if not study.necking_file.is_file():
        raise DataError(f"{study.necking_file}: no such file; expected the displacements of a grid, check key 'necking.file'")
    task = job(study.run_dir, NAME, study.config_of("necking"), {"grid": study.necking_file})
    return produce(task, lambda: _make(study), force=force)


def sections(study: Study) -> SectionStrains:
    """Strains of the sections of a study. DataError for frames or rows that the file does not have."""
    settings, path = study.necking, study.necking_file
    assert settings is not None and path is not None
    grid = read_grid(path, settings.load_axis)
    rows = (0, len(grid.along) - 1) if settings.rows is None else settings.rows
    for key, last, n in (("fit_frames", settings.fit_frames[1], len(grid.place)), ("rows", rows[1], len(grid.along))):
        if last >= n:
            raise DataError(f"{path}: key 'necking.{key}' ends at {last}, but the file has {n} (0 to {n - 1}); correct the key")
    first, end = settings.fit_frames
    return sections_of(section_strain(grid, first, rows, settings.rows_per_section, settings.noise), end - first + 1)


def _make(study: Study) -> Made:
    settings = study.necking
    assert settings is not None
    begin = time.perf_counter()
    found = sections(study)
    fit = fit_sections(found, settings.hardening_rate)
    rates, seen = other_rates(found, settings.hardening_rate), onset(found)
    picture = _draw(study, found, fit, rates, seen)
    summary = _summary(settings, found, fit, rates, seen)
    counts = fit.result.counts
    summary["evaluations"] = {"forward": counts.forward, "failed": counts.failed, "wall_s": time.perf_counter() - begin}
    return Made(_datasets(found, fit), {**summary, "picture": picture}, _parameters(fit))


def _summary(
    settings: Necking, found: SectionStrains, fit: NeckingFit, rates: list[dict[str, float]], seen: Onset | None
) -> dict[str, Any]:
    last = found.n_fit - 1
    test, neck, (mean, spread) = held_out(found, fit), neck_shape(found, last), contraction(found, last)
    value, sigma = fit.law.considere, fit.sigma("considere_strain")
    values = [value, *(row["considere_strain"] for row in rates)]
    total = (found.n_fit - 1) * found.used.shape[1]
    remarks = [
        f"hardening_rate {settings.hardening_rate:g} is prescribed, for the areas of the sections are not known: M_yinf/M_y0 and "
        f"H_lin/M_y0 follow from it and are not determined; Considere strain {min(values):.4f} to {max(values):.4f} for rates "
        f"{min(row['hardening_rate'] for row in rates):.3g} to {max(row['hardening_rate'] for row in rates):.3g}",
        f"of {total} fitted samples {found.excluded} are left out: their sections had stopped straining",
        f"neck at frame {last}: a/R = {neck.a_over_r:.3f}, mean stress wrong by about {100 * neck.stress_error:.2f} %, not corrected",
        f"width strain {mean:.3f} +- {spread:.3f} of the axial strain (isotropic sheet: 0.5); thickness is not seen, flow is taken as "
        "isochoric",
    ]
    if test is not None:
        remarks.append(
            f"{test.n} strains of later frames, one width from the neck or more: rms error {test.rms:.2g} where they gain {test.gain:.2g} "
            f"(noise {test.noise:.1g}); at the end {test.final:+.2g}"
        )
    line, good = judged(fit, seen, 0.5 * (max(values) - min(values)))
    return {
        "verdict": f"Considere strain {value:.4f} +- {sigma:.4f} since frame {settings.fit_frames[0]}, H_exp {fit.law.exponent:.1f} +- "
        f"{fit.sigma('H_exp'):.1f}; {line}",
        "trustworthy": good and fit.result.converged,
        "message": fit.result.message,
        "channels": {"strain": _channel(found, fit)},
        "rates": rates,
        "localisation": None if seen is None else asdict(seen),
        "held_out": None if test is None else asdict(test),
        "determined": ["considere_strain", *(["H_exp"] if 2.0 * fit.sigma("H_exp") < fit.law.exponent else [])],
        "remarks": remarks,
    }


def judged(fit: NeckingFit, seen: Onset | None, spread: float) -> tuple[str, bool]:
    """The Considere strain beside the strain at which sections far from the neck stop, and whether they agree.

    `spread` is half the range of the Considere strain over the prescribed rates: an error of its own.
    """
    if seen is None:
        return "no section far from the neck stops straining: no test of it", True
    sigma = float(np.linalg.norm([fit.sigma("considere_strain"), seen.sigma, spread]))
    off = (seen.strain - fit.law.considere) / sigma
    text = f"localisation seen at {seen.strain:.4f} +- {seen.sigma:.4f} (frame {seen.frame:.0f})"
    if abs(off) <= BEYOND:
        return f"{text}, {abs(off):.1f} standard errors away", True
    when = "later" if off > 0 else "earlier"
    return f"{text}, {abs(off):.1f} standard errors {when}: the law, equal initial sections or rate independence does not hold", False


def _channel(found: SectionStrains, fit: NeckingFit) -> dict[str, Any]:
    rms = float(np.sqrt(np.mean(fit.result.residual**2)))
    noise = float(np.sqrt(np.mean(found.strain.sigma**2)))
    return {
        "unit": "1",
        "n": fit.covariance.n,
        "rms": rms * noise,
        "floor_rms": noise,
        "chi2_reduced": fit.covariance.s2,
        "independent": fit.independent,
    }


def _parameters(fit: NeckingFit) -> dict[str, ParameterResult]:
    out = {}
    for k, name in enumerate(("considere_strain", "H_exp")):
        low, high = BOUNDS[name]
        sigma, start = fit.sigma(name), fit.result.log[0].x[k]
        known = sigma if np.isfinite(sigma) else None
        out[name] = ParameterResult(float(fit.result.x[k]), known, "1", True, bool(fit.result.at_bound[k]), float(start), low, high)
    for name, value in (("M_yinf_over_M_y0", 1.0 + fit.law.voce), ("H_lin_over_M_y0", fit.law.linear)):
        out[name] = ParameterResult(value, None, "1", False, False, value, -np.inf, np.inf)
    return out


def _datasets(found: SectionStrains, fit: NeckingFit) -> dict[str, Dataset]:
    strain = found.strain
    x = np.linspace(0.0, fit.law.considere, 50)
    return {
        "strain/axial": Dataset(strain.axial, "1", ("frame", "section")),
        "strain/width": Dataset(strain.width, "1", ("frame", "section")),
        "strain/sigma": Dataset(strain.sigma, "1", ("section",)),
        "strain/predicted": Dataset(predicted(found, fit), "1", ("frame", "other")),
        "strain/offset": Dataset(fit.offset, "1", ("other",)),
        "strain/other": Dataset(found.others, "1", ("other",)),
        "strain/used": Dataset(found.used.astype(np.int8), "1", ("frame", "section")),
        "strain/at": Dataset(strain.at, strain.unit, ("section",)),
        "law/strain": Dataset(x, "1", ("sample",)),
        "law/stress": Dataset(fit.law.stress(x), "1", ("sample",)),
    }


def _draw(study: Study, found: SectionStrains, fit: NeckingFit, rates: list[dict[str, float]], seen: Onset | None) -> str:
    x = np.linspace(0.0, 1.1 * fit.law.considere, 80)
    laws = [fit.law, *(HardeningLaw(row["considere_strain"], row["H_exp"], row["hardening_rate"]) for row in rates)]
    strain = found.strain
    drawn = NeckingPicture(
        tau=strain.axial[:, found.neck],
        measured=strain.axial[:, found.others],
        model=predicted(found, fit),
        at=strain.at[found.others],
        n_fit=found.n_fit,
        strain=x,
        laws=np.array([law.stress(x) for law in laws]),
        rates=tuple(law.rate for law in laws),
        considere=(fit.law.considere, fit.sigma("considere_strain")),
        seen=None if seen is None else seen.strain,
        unit=strain.unit,
    )
    try:
        with matplotlib.rc_context(STYLE):
            return str(save_figures(study.run_dir, {NAME: necking_figure(drawn)})[0])
    except OSError as error:
        raise StudyError(f"necking: '{study.run_dir}' cannot be written ({error}): expected a writable folder with free space") from error
