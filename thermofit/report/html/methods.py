"""Text of methods with references, made from what ran: sentences with keys as pandoc reads them, and the entries that they use."""

from __future__ import annotations

import importlib.resources
import re
from collections.abc import Iterator

from thermofit import __version__
from thermofit.core.errors import StudyError
from thermofit.core.parameters import param
from thermofit.effects.catalogue import effect
from thermofit.law.surface.catalogue import surface
from thermofit.report.html.gather import LOOP, VERIFY, channel_words
from thermofit.report.html.run_folder import IDENTIFY, REFINE, Records, RunFolder
from thermofit.study.section import MeshSize, SheetSize, recorded_mesh

_ENTRY = re.compile(r"^@\w+\{(?P<key>\w+),.*?^\}$", re.MULTILINE | re.DOTALL)
_CITED = re.compile(r"@(\w+)")


def methods_text(run: RunFolder) -> str:
    """Markdown: a paragraph for each part of the work that ran."""
    records = {stage: record for one in (*run.tests.values(), run.records) for stage, record in one.items()}
    parts = [text for make in (_data, _model, _fit, _loop, _software) if (text := " ".join(make(records, run)))]
    return "# Methods\n\n" + "\n\n".join(parts) + "\n"


def references(text: str, run: RunFolder) -> str:
    """BibTeX entries that a text cites, and one for the source of each effect that was added."""
    stored = importlib.resources.files("thermofit.report.html").joinpath("references.bib").read_text(encoding="utf-8")
    known = {found["key"]: found[0] for found in _ENTRY.finditer(stored)}
    cited = dict.fromkeys(_CITED.findall(text))
    entries = [known[key] for key in cited if key in known]
    entries += [_entry(name, source) for name, source in _sources(run) if _key(name) in cited]
    entries.append(f"@software{{thermofit,\n  title = {{thermofit}},\n  version = {{{__version__}}}\n}}")
    return "\n\n".join(entries) + "\n"


def _data(records: Records, run: RunFolder) -> Iterator[str]:
    record = records.get("interpolate")
    if record is None:
        return
    s = record.summary
    if len(run.tests) > 1:
        yield f"{len(run.tests)} experiments were evaluated together: {', '.join(run.tests)}."
    if (u := s.get("displacement")) is not None and record.has("u/time"):
        noise = " and ".join(f"{1e3 * v:.2f}" for v in u["noise_mm"])
        yield (
            f"Displacements from digital image correlation were interpolated to {u.get('nodes', 'the')} points of the specimen in "
            f"{len(record['u/time'].value)} stages; their noise is {noise} um across and along the load ({u['noise_method']})."
        )
    if (motion := s.get("motion")) is not None:
        used = ", ".join(f"{name} = {value:g} {param(name).unit}".removesuffix(" 1") for name, value in motion["parameters"].items())
        yield f"Displacements were not measured: the motion of the specimen was computed under the measured force with {used}."
    if (theta := s.get("temperature")) is not None and record.has("theta/time"):
        yield (
            f"Temperatures from an infrared camera were taken at the current positions of the same points in "
            f"{len(record['theta/time'].value)} frames; their noise is {1e3 * theta['noise_K']:.1f} mK ({theta['noise_method']})."
        )
    if (force := s.get("force")) is not None and force.get("noise_N") is not None:
        yield f"The force, with a noise of {force['noise_N']:.2f} N, was smoothed to its noise level, phase by phase of the programme."
    if rows := s.get("records"):
        yield f"{len(rows)} uniaxial records were evaluated: {', '.join(str(r['record']) for r in rows)}."


def _model(records: Records, run: RunFolder) -> Iterator[str]:
    record = next((records[stage] for stage in (VERIFY, *reversed(IDENTIFY)) if stage in records), None)
    if record is None:
        return
    config = record.config
    law = config.get("hardening") or f"model {config.get('model', '?')}"
    cited = " [@voce1948]" if config.get("hardening") in (None, "voce") else ""
    chosen = config.get("yield_surface", "hill")
    yields = "of Hill [@hill1948]" if chosen == "hill" else f"{chosen} ({surface(chosen).file.SOURCE})"
    yield (
        f"The model is a thermo-mechanically coupled plasticity at finite strains with the yield surface {yields} and the "
        f"hardening law {law}{cited}; the framework follows [@rose2020; @rose2021]."
    )
    if config.get("coupon"):
        yield "Every record was followed by a material point under uniaxial stress with a lumped balance of heat."
    else:
        yield _meshed(recorded_mesh(config.get("mesh", "full")))
        yield "Heat was integrated in time by a two-stage scheme [@alexander1977]."


def _meshed(size: MeshSize) -> str:
    if not isinstance(size, SheetSize):
        return f"The specimen was modelled by eight-node hexahedra on a mesh of {size.words} elements."
    return (
        f"The specimen was modelled as a sheet, by one layer of {size.n_x} x {size.n_y} eight-node hexahedra over half its thickness; what "
        f"it misses was estimated from a body of {size.body.words} elements."
    )


def _fit(records: Records, run: RunFolder) -> Iterator[str]:
    for stage in IDENTIFY:
        if stage not in records:
            continue
        record = records[stage]
        free = [name for name, p in record.parameters.items() if p.free]
        channels = ", ".join(channel_words(c) for c in record.summary.get("channels", {}))
        how = record.summary.get("algorithm") or record.summary.get("method") or "least squares"
        yield (
            f"{stage} fitted {', '.join(free) or 'nothing'} to {channels or 'the data'} by weighted least squares ({how}), "
            "each datum with its noise."
        )
    if any(stage in records for stage in IDENTIFY):
        yield (
            "Derivatives come from direct differentiation of the discrete equations [@kleiber1997]; where much of the data stays "
            "unexplained, second derivatives are added [@dennis1981]. Uncertainties are combined standard ones: noise of the data, "
            "corrected for its correlation in time [@newey1987], and what is stated of everything that was prescribed."
        )
    if REFINE in records and records[REFINE].summary.get("refined"):
        free = [name for name, p in records[REFINE].parameters.items() if p.free]
        yield (
            f"At last {', '.join(free)} were fitted together to all channels. Readings of thermocouples are data with an error, and the "
            "error of the smoothed force is noise. The errors of mesh and time steps come from a finer mesh and half the steps, and are in "
            "the data."
        )


def _loop(records: Records, run: RunFolder) -> Iterator[str]:
    record = records.get(LOOP) or records.get("diagnose")
    if record is None:
        return
    s = record.summary
    asked = len(s.get("ranking", ()))
    yield (
        f"All parameters were then fitted at once to all channels, and the response of the model to each of {asked} further effects was "
        f"computed. Held out were {s.get('held_out', 'blocks of the data')}. The error of mesh and time steps was estimated by a finer "
        "solution and taken into account as a deferred correction [@stetter1978]."
    )
    if record.stage != LOOP:
        return
    added = [str(name) for name in s.get("accepted", ())]
    said = ", ".join(f"{name} [@{_key(name)}]" for name in added) or "none"
    yield (
        "An effect was added where it lowers the error on held-out data by more than its uncertainty; of those within one standard "
        f"error of the best the simplest was taken [@breiman1984]. Added: {said}."
    )
    if s.get("unlisted") is not None:
        yield "What no listed effect explains was reconstructed as a source; its variables were chosen by stability selection"
        yield "[@meinshausen2010]."


def _software(records: Records, run: RunFolder) -> Iterator[str]:
    last = next(reversed(list(records.values())), None)
    if last is not None:
        packages = last.attributes["packages"]
        versions = ", ".join(f"{name} {packages[name]}" for name in packages if name != "python")
        yield (
            f"Software: thermofit {last.attributes['thermofit_version']} (source {str(last.attributes['source_digest'])[:12]}) "
            f"[@thermofit] under Python {packages.get('python', '?')}, with {versions} [@harris2020; @virtanen2020; @lam2015]."
        )


def _sources(run: RunFolder) -> Iterator[tuple[str, str]]:
    record = run.records.get(LOOP)
    for name in () if record is None else record.summary.get("accepted", ()):
        try:
            yield str(name), effect(str(name)).source
        except StudyError:
            yield str(name), "effect file of the user"


def _key(name: str) -> str:
    return "effect_" + re.sub(r"\W", "_", name)


def _entry(name: str, source: str) -> str:
    """Entry of the source of an effect, in words; braces would end it early."""
    clean = re.sub(r"[{}\\]", "", source)
    return f"@misc{{{_key(name)},\n  title = {{{re.sub(r'[{}]', '', name)}, effect of thermofit}},\n  note = {{{clean}}}\n}}"
