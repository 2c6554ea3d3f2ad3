"""Writing a report: `report.html`, `report.json`, `methods.md` and `methods.bib` of a run folder."""

from __future__ import annotations

import base64
import hashlib
import importlib.resources
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import DictLoader, Environment, StrictUndefined
from markupsafe import Markup
from matplotlib import rc_context

from thermofit.core.errors import StudyError
from thermofit.core.files import replacing
from thermofit.core.jsonable import jsonable
from thermofit.report.balances import GROUP, maps_of, significance_figure
from thermofit.report.figures import STYLE, png
from thermofit.report.html.captions import CAPTIONS
from thermofit.report.html.content import Report
from thermofit.report.html.gather import DIAGNOSE, LOOP, channel_words, report_of, unlisted_words
from thermofit.report.html.methods import methods_text, references
from thermofit.report.html.run_folder import RunFolder, read_run
from thermofit.report.html.views import views_of
from thermofit.report.local_words import balance_lines, drift_line, held_in_words, second_in_words, travel_in_words
from thermofit.study.study import Study

HTML, JSON, METHODS, REFERENCES = "report.html", "report.json", "methods.md", "methods.bib"
_ROWS = 12
"""Candidate causes that stand on the first page; the others are one click away."""


@dataclass(frozen=True)
class Written:
    """What was written: paths of the page, its JSON twin, methods and references, and the content."""

    html: Path
    json: Path
    methods: Path
    references: Path
    content: Report


def write_report(run_dir: Path, study: Study | None = None, *, failure: str = "") -> Written:
    """The report of whatever a run folder holds; `failure`: the error that ended the run. StudyError where it holds nothing or cannot be
    written."""
    run = read_run(run_dir)
    content = report_of(run, study, failure)
    text = methods_text(run)
    entries = references(text, run)
    views = views_of(run, study)
    texts = {
        HTML: rendered(content, views, text, _significance_map(run)),
        JSON: json.dumps(jsonable(content.model_dump()), indent=1, allow_nan=False) + "\n",
        METHODS: text,
        REFERENCES: entries,
    }
    try:
        for name, one in texts.items():
            with replacing(run_dir / name, durable=False) as temporary:
                Path(temporary).write_text(one, encoding="utf-8")
    except OSError as error:
        raise StudyError(f"report: '{run_dir}' cannot be written ({error}): expected a writable folder with free space") from error
    return Written(run_dir / HTML, run_dir / JSON, run_dir / METHODS, run_dir / REFERENCES, content)


def _significance_map(run: RunFolder) -> str:
    """The figure of the local balances of the last diagnosis as base64 of a PNG; empty where there is none."""
    record = next((run.records[stage] for stage in (LOOP, DIAGNOSE) if run.has(stage)), None)
    maps = [] if record is None else maps_of({name: record[name] for name in record.names if name.startswith(f"{GROUP}/")})
    if not maps:
        return ""
    with rc_context(STYLE):
        return base64.b64encode(png(significance_figure(maps))).decode("ascii")


def rendered(content: Report, views: dict[str, Any], methods: str, significance_map: str = "") -> str:
    """The page as one text; `significance_map`: base64 of a PNG.

    All that comes from data is escaped, and the policy of the page runs no script but the viewer itself.
    """
    viewer, style = _source("viewer.js"), _source("page.css")
    environment = Environment(
        loader=DictLoader({"page": _source("page.html.j2")}),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": _number, "level": _level, "share": _share}
    environment.filters |= {"travel": travel_in_words, "second": second_in_words, "held": held_in_words}
    bars = [v for b in content.bars for level in (b.fit, b.held_out) for v in (level.before, level.after) if v is not None]
    return environment.get_template("page").render(
        r=content,
        captions=CAPTIONS,
        rows=_ROWS,
        words=channel_words,
        top=max([1.5, *(1.08 * v for v in bars)]),
        reach=_reach(content),
        views=Markup(_data({**views, "profiles": [p.model_dump() for p in content.profiles], "unlisted": _over_time(content)})),
        unlisted=None if content.unlisted is None else unlisted_words(content.unlisted),
        balances=[] if content.local_balances is None else balance_lines(content.local_balances),
        drifts=[drift_line(row) for row in (content.drift or {}).get("found", ())],
        significance_map=significance_map,
        methods=methods.partition("\n\n")[2].strip().split("\n\n"),
        has_fields=bool(views["tests"]),
        has_maps=any(t["maps"] or t["fields"] for t in views["tests"]),
        has_pair=any(m["after"] is not None for t in views["tests"] for m in t["maps"]),
        has_records=bool(views["records"]),
        cameras=views["cameras"],
        thinned=views["thinned"],
        style=Markup(style),
        viewer=Markup(viewer),
        viewer_hash=base64.b64encode(hashlib.sha256(viewer.encode("utf-8")).digest()).decode("ascii"),
    )


def _source(name: str) -> str:
    return importlib.resources.files("thermofit.report.html").joinpath(name).read_text(encoding="utf-8")


def _data(value: Any) -> str:
    """JSON that no text in it can leave: within a script element only `<` could."""
    text = json.dumps(jsonable(value), allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _over_time(content: Report) -> dict[str, Any] | None:
    said = content.unlisted or {}
    return {**said["over_time"], "unit": said.get("unit") or "1"} if said.get("over_time") else None


def _reach(content: Report) -> float:
    """Largest gain with its interval, for the bars of the ladder."""
    ends = [abs(rung.gain) + 2.0 * (rung.gain_sigma or 0.0) for rung in content.ladder if rung.gain is not None]
    return min(max([0.05, *ends]), 1.2)


def _number(value: float | None, digits: int = 4) -> str:
    """A number of so many digits; a dash where there is none."""
    return "\u2013" if value is None else f"{value:.{digits}g}"


def _level(value: float | None) -> str:
    """A level in units of the noise: three digits, and nothing below a thousandth."""
    return _number(value, 3) if value is None or value >= 1e-3 else "below 0.001"


def _share(value: float, low: float, high: float) -> str:
    """Place of a value between two others in per cent, for the style of a bar; held within them."""
    return f"{100.0 * min(max((value - low) / (high - low), 0.0), 1.0):.2f}%"
