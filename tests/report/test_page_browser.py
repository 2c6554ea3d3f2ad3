"""The page in a browser: it draws what it should, complains of nothing, asks for nothing, and fits narrow and wide windows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import report_runs as made
from browser import Browser, browser, chromium
from looked_at import BEYOND, OVERLAP, clicked, drawn, opens_well

from thermofit.report.html.page import write_report

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium found: install the package `chromium` to look at the report")


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(chromium() or "", tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(made.whole_run(tmp_path_factory.mktemp("page"))).html


@pytest.mark.parametrize(("width", "dark"), [(400, False), (400, True), (900, False), (1600, False), (1600, True)])
def test_it_opens_without_complaint(tab: Browser, page: Path, width: int, dark: bool) -> None:
    opens_well(tab, page, width, dark=dark)


def test_slider_flicker_and_click_change_the_picture(tab: Browser, page: Path) -> None:
    tab.open(page, 1600)
    first = drawn(tab, "map")
    tab.value("(e => { e.value = 3; e.dispatchEvent(new Event('input')); })(document.getElementById('time'))")
    assert drawn(tab, "map") != first and tab.value("document.getElementById('time-text').textContent").startswith("18 s loading")
    tab.value("document.getElementById('swap').click()")
    after = drawn(tab, "map")
    assert tab.value("document.getElementById('map-title').textContent").startswith("AFTER, with lamp")
    pause = "new Promise(done => setTimeout(done, 1000))"
    tab.value("document.getElementById('flicker').click()")
    tab.value(pause)
    assert drawn(tab, "map") != after
    tab.value("document.getElementById('flicker').click()")
    still = drawn(tab, "map")
    tab.value(pause)
    assert drawn(tab, "map") == still, "it stops"
    curves = [drawn(tab, f"plot-{k}") for k in "abc"]
    title, *there = clicked(tab, 0.15, 0.85)
    assert all(now != before for now, before in zip(there, curves, strict=True)) and "x = -10 mm, y = -15 mm" in title
    tab.value("document.getElementById('map').dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowUp' }))")
    assert "x = -10 mm, y = -10 mm" in tab.value("document.getElementById('point-title').textContent")


def test_it_begins_where_the_model_is_worst(tab: Browser, page: Path) -> None:
    tab.open(page, 1600)
    assert tab.value("document.getElementById('map-what').selectedOptions[0].textContent") == "residual of the temperature rise"
    assert int(tab.value("document.getElementById('time').value")) >= len(made.TIME) - 3


def test_every_view_can_be_drawn(tab: Browser, page: Path) -> None:
    tab.open(page, 900)
    seen = tab.value(
        "[...document.getElementById('map-what').options].flatMap(o => [...document.getElementById('map-mode').options].map(m => {"
        " for (const [id, v] of [['map-what', o.value], ['map-mode', m.value]]) {"
        " const e = document.getElementById(id); e.value = v; e.dispatchEvent(new Event('change')); }"
        " return document.getElementById('map').toDataURL(); }))"
    )
    assert len(seen) == 18 and len(set(seen)) == 18 and tab.complaints() == []
    pictures = []
    for frame in (0, 3):
        tab.value(f"(e => {{ e.value = {frame}; e.dispatchEvent(new Event('input')); }})(document.getElementById('camera-time'))")
        pictures.append(tab.value("document.getElementById('camera-title').textContent"))
    assert pictures[0] != pictures[1]


def test_records_and_half_runs_open_too(tab: Browser, tmp_path: Path) -> None:
    for folder in (made.records_run(tmp_path / "records"), made.write(tmp_path / "half", made.interpolated())):
        for width in (400, 1600):
            tab.open(write_report(folder).html, width)
            assert tab.complaints() == [] and tab.value("document.documentElement.dataset.ready") == "yes"
            assert tab.value(BEYOND) == [] and tab.value(OVERLAP) == []


def test_nothing_of_the_data_runs(tab: Browser, tmp_path: Path) -> None:
    h = made.HOSTILE
    made.whole_run(tmp_path, accepted=["lamp", h], undecided=[h])
    made.write(tmp_path, made.interpolated(verdict=h, phases=[{"label": h, "t0": 0.0, "t1": 90.0}]), made.calibrated(verdict=h))
    tab.open(write_report(tmp_path).html, 900)
    assert tab.value("document.documentElement.dataset.ready") == "yes"
    assert tab.value("typeof window.taken") == "undefined" and tab.requests() == [(tmp_path / "report.html").as_uri()]
    tab.value("document.body.insertAdjacentHTML('beforeend', '<img src=x onerror=\"window.taken = 1\">')")
    tab.value("new Promise(done => setTimeout(done, 200))")
    assert tab.value("typeof window.taken") == "undefined", "the policy of the page holds even for markup that got in"
