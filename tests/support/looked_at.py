"""What a page of the report has to do in a browser, whatever run it is of."""

from __future__ import annotations

from pathlib import Path

from browser import Browser

BEYOND = (
    "[...document.querySelectorAll('main *')].filter(e => !e.closest('.wide') && !e.closest('details:not([open])')"
    " && e.getBoundingClientRect().right > innerWidth + 1).map(e => e.tagName + '.' + e.className)"
)
"""Elements that reach beyond the window and cannot be scrolled to."""
OVERLAP = (
    "[...document.querySelectorAll('.card h2, .card h3, .bar, .controls, .slider, canvas')].filter(e => e.offsetParent)"
    ".map(e => [e, e.getBoundingClientRect()]).filter(([e, a], i, all) => all.slice(i + 1).some(([f, b]) =>"
    " !e.contains(f) && !f.contains(e) && a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1))"
    ".map(([e]) => e.id || e.className)"
)
"""Blocks that lie on each other."""
FIRST_PAINT = (
    "new Promise((done, failed) => { const begin = performance.now(); (function ask() {"
    " const found = performance.getEntriesByName('first-contentful-paint')[0];"
    " if (found) done(found.startTime);"
    " else if (performance.now() - begin > 30000) failed('nothing was painted');"
    " else setTimeout(ask, 50); })(); })"
)
"""Time of the first paint in ms; a busy browser tells it some time after it."""
PAUSE = "new Promise(done => setTimeout(done, 1000))"


def drawn(tab: Browser, name: str) -> str:
    """The picture in a canvas."""
    return str(tab.value(f"document.getElementById('{name}').toDataURL()"))


def opens_well(tab: Browser, page: Path, width: int, *, dark: bool = False) -> None:
    """It is ready, complains of nothing, asks for nothing but itself, paints within 2 s, and nothing is cut off or lies on other things."""
    tab.open(page, width, dark=dark)
    assert tab.value("document.documentElement.dataset.ready") == "yes"
    outside = [asked for asked in tab.requests() if not asked.startswith("data:")]  # pictures in the file itself
    assert tab.complaints() == [] and outside == [page.as_uri()]
    paints = []
    for _ in range(5):  # the best of several: the machine may have other things to do
        tab.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 50))))")
        paints.append(tab.value(FIRST_PAINT))
        if paints[-1] < 2000:
            break
        tab.open(page, width, dark=dark)
    assert min(paints) < 2000, paints
    assert tab.value("document.documentElement.scrollWidth") <= width and tab.value(BEYOND) == [] and tab.value(OVERLAP) == []


def clicked(tab: Browser, x: float, y: float) -> list[str]:
    """The curves of the point that is clicked at parts of the width and the height of the map, and above them where it lies."""
    tab.value(
        "(e => { const b = e.getBoundingClientRect();"
        f" e.dispatchEvent(new MouseEvent('click', {{ clientX: b.left + {x} * b.width, clientY: b.top + {y} * b.height }})); }})"
        "(document.getElementById('map'))"
    )
    return [str(tab.value("document.getElementById('point-title').textContent")), *(drawn(tab, f"plot-{k}") for k in "abc")]


def moves(tab: Browser, page: Path, *, before_and_after: bool) -> None:
    """The slider and a click change the picture, and so does the flicker where there is a before and an after."""
    tab.open(page, 1600)
    last = int(tab.value("document.getElementById('time').max"))
    pictures = []
    for k in (1, last // 2, last):
        tab.value(f"(e => {{ e.value = {k}; e.dispatchEvent(new Event('input')); }})(document.getElementById('time'))")
        pictures.append(drawn(tab, "map"))
    assert len(set(pictures)) == 3
    one, other = clicked(tab, 0.5, 0.45), clicked(tab, 0.5, 0.6)
    assert "x = " in one[0] and one[0] != other[0] and one[1] != other[1] and one[2:] != other[2:]
    if before_and_after:
        tab.value("document.getElementById('swap').click()")
        assert drawn(tab, "map") != pictures[-1]
        seen = {drawn(tab, "map")}
        tab.value("document.getElementById('flicker').click()")
        for _ in range(3):
            tab.value(PAUSE.replace("1000", "350"))
            seen.add(drawn(tab, "map"))
        tab.value("document.getElementById('flicker').click()")
        assert len(seen) > 1
    assert tab.complaints() == []
