"""Effect files of reconstructed terms: of the kind that a user writes (docs/effects.md), to run, to fit and to edit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import indent

import numpy as np

from thermofit.effects.film_exchange import FILM_UNIT
from thermofit.experiment.missing import KINDS, Grid
from thermofit.experiment.missing_body import PER_MILLE

_HEAD = '''"""{what}: slot {slot}. Off at scale = 0.

Reconstructed by thermofit from what the fitted model left over; scale = 1 is the term as it was found. It describes, it explains
nothing: edit it into a law.
"""

from __future__ import annotations

{imports}

SLOT = "{slot}"
{on}PARAMS = (Param("{name}.scale", "1", 0.0, -10.0, 10.0, 0.1, "share of the reconstructed term", probe=1.0),)
FORMULA = "{formula}"
SOURCE = "reconstructed from the residual of {source}"

'''
_NUMPY = "import numpy as np\n\nfrom thermofit.core.parameters import Param"
_SCENE = _NUMPY + "\nfrom thermofit.effects.scene import Scene"
_HATS = '''

def _hats(knots: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values (..., n) of hat functions at the knots; nothing beyond the last ones."""
    return np.stack([np.interp(at, knots, row, left=0.0, right=0.0) for row in np.eye(len(knots))], axis=-1)

'''


def _head(what: str, slot: str, name: str, formula: str, source: str, imports: str, on: Sequence[str] = ()) -> str:
    """The head of an effect file; `on`: the facet sets on which it acts."""
    return _HEAD.format(what=what, slot=slot, name=name, formula=formula, source=source, imports=imports, on=f"ON = {on!r}\n" if on else "")


def _array(name: str, values: np.ndarray, comment: str) -> str:
    """An array as source text, six digits."""
    text = np.array2string(np.asarray(values), separator=", ", precision=6, threshold=10**9, max_line_width=130)
    text = text.replace("\n", "\n    ")
    return f'{name} = np.array(\n    {text}\n)\n"""{comment}"""\n'


def heat_file(name: str, source: str, grid: Grid, values: np.ndarray, folded: bool) -> str:
    """Effect of slot heat_source from coefficients (n_k, n_y, n_x) in mW/mm^3."""
    head = _head(
        what="A heat source over place and time",
        slot="heat_source",
        name=name,
        formula="r += scale q(x, y, t)",
        source=source,
        imports=_NUMPY,
    )
    side = "np.abs(x)" if folded else "x"
    tables = (
        _array("TIME", grid.time, "s; knots in time.")
        + _array("X", grid.x, "mm; knots across" + (", the same on both sides." if folded else "."))
        + _array("Y", grid.y, "mm from the middle; knots along the load.")
        + _array("POWER", values, "mW/mm^3 of reference volume at the knots (time, y, x).")
    )
    body = f'''
def heat_source(time: float, x: np.ndarray, y: np.ndarray, scale: float) -> np.ndarray:
    """Power of the source, mW/mm^3."""
    now = np.tensordot(_hats(TIME, np.array(time)), POWER, axes=1)
    across, along = _hats(X, np.clip({side}, X[0], X[-1])), _hats(Y, y)
    return np.asarray(scale * np.einsum("...j,...i,ji->...", along, across, now))
'''
    return head + tables + _HATS + body


def camera_file(name: str, source: str, grid: Grid, values: np.ndarray) -> str:
    """Effect of slot camera from coefficients (n_k, n_y, n_x, 2) in mm."""
    head = _head(
        what="A displacement that the model does not have",
        slot="camera",
        name=name,
        formula="u_camera = u + scale d(x, y, t)",
        source=source,
        imports=_SCENE,
    )
    tables = (
        _array("TIME", grid.time, "s; knots in time.")
        + _array("X", grid.x, "mm; knots across.")
        + _array("Y", grid.y, "mm; knots along the load.")
        + _array("MOTION", values, "mm at the knots (time, y, x), components x and y.")
    )
    body = '''
def camera(u: np.ndarray, scene: Scene, scale: float) -> np.ndarray:
    """u and the missing displacement, mm (n_t, n_s, 2)."""
    place = (scene.position - np.real(u))[0]
    along, across = _hats(Y, place[:, 1]), _hats(X, place[:, 0])
    return np.asarray(u + scale * np.einsum("tk,sj,si,kjic->tsc", _hats(TIME, scene.time), along, across, MOTION))
'''
    return head + tables + _HATS + body


@dataclass(frozen=True)
class _Alike:
    """The effect file of a kind of term that is the same everywhere: its slot, facet sets and formula, what its function takes and says,
    and what it gives, by `now`, the history in the `unit` of a file at the times of the function."""

    slot: str
    formula: str
    takes: str
    says: str
    gives: str
    on: tuple[str, ...] = ()
    unit: float = 1.0


_AT_SENSOR = ("theta: np.ndarray, scene: Scene, scale: float", "Temperature as the camera shows it, K (n_t, n_s).")
_AT_CAMERAS = ("u: np.ndarray, scene: Scene, scale: float", "Displacements as the cameras show them, mm (n_t, n_s, 2).")
_AT_JAWS = (
    "y: np.ndarray, time: float, elapsed: float, scale: float",
    "Change of the temperature of the jaws, K; y in mm from the middle.",
)
_AT_SURFACE = ("theta: np.ndarray, time: float, surroundings: np.ndarray, scale: float", "Outward flux, mW/mm^2 of current area.")
_ALIKE: Mapping[str, _Alike] = {
    "flux": _Alike("surface_flux", "q -= scale q_in(t)", *_AT_SURFACE, "-scale * now + 0.0 * theta", ("air",)),
    "film": _Alike(
        "surface_flux",
        "q += scale h(t) (theta - theta_M)",
        *_AT_SURFACE,
        "scale * now * (theta - surroundings)",
        ("air",),
        FILM_UNIT,
    ),
    "jaws": _Alike("boundary_temperature", "theta_M += scale T(t)", *_AT_JAWS, "scale * now + 0.0 * y", ("clamp",)),
    "jaw_upper": _Alike("boundary_temperature", "theta_M += scale T(t) where y > 0", *_AT_JAWS, "scale * now * (y >= 0.0)", ("clamp",)),
    "jaw_lower": _Alike("boundary_temperature", "theta_M += scale T(t) where y < 0", *_AT_JAWS, "scale * now * (y <= 0.0)", ("clamp",)),
    "offset": _Alike("sensor", "theta_camera = theta + scale T(t)", *_AT_SENSOR, "theta + scale * now[:, None]"),
    "gradient": _Alike(
        "sensor",
        "theta_camera = theta + scale g(t) (y - y_0)",
        *_AT_SENSOR,
        "theta + scale * now[:, None] * (scene.position[:, :, 1] - MIDDLE)",
        (),
        PER_MILLE,
    ),
    "clock": _Alike(
        "sensor",
        "theta_camera = theta + scale T(t) d theta/dt",
        *_AT_SENSOR,
        "theta + scale * now[:, None] * np.gradient(theta, scene.time, axis=0)",
    ),
    "strain": _Alike(
        "camera", "u_camera = u + scale e(t) (x + u)", *_AT_CAMERAS, "u + scale * now[:, None, None] * scene.position", (), PER_MILLE
    ),
    "scale": _Alike("camera", "u_camera = u + scale e(t) u", *_AT_CAMERAS, "u + scale * now[:, None, None] * u", (), PER_MILLE),
}


def over_time_file(kind: str, name: str, source: str, grid: Grid, values: np.ndarray) -> str:
    """Effect of a kind of term that is the same everywhere, from its history: coefficients (n_k,) in the unit of the kind at the times of a
    grid, whose one knot in y is the middle of what grows from one.

    What comes through the surface begins after the first time, at which the specimen rests in the balance that the model knows.
    """
    own = _ALIKE[kind]
    heats = KINDS[kind].alike != "image"
    head = _head(
        what=f"{KINDS[kind].words[0].upper()}{KINDS[kind].words[1:]} over time",
        slot=own.slot,
        on=own.on,
        name=name,
        formula=own.formula,
        source=source,
        imports=_NUMPY if heats else _SCENE,
    )
    tables = _array("TIME", grid.time, "s; knots in time.") + _array(
        "HISTORY", own.unit * values, "Coefficients of the formula at the knots."
    )
    if KINDS[kind].about:
        tables += f'MIDDLE = {grid.y[0]:.6g}\n"""mm; y_0, where it is nothing."""\n'
    at = "np.interp(time, TIME, HISTORY, left=0.0, right=0.0) * (time > TIME[0])" if heats else "np.interp(scene.time, TIME, HISTORY)"
    body = f'''

def {own.slot}({own.takes}) -> np.ndarray:
    """{own.says}"""
    now = {at}
    return np.asarray({own.gives})
'''
    return head + tables + body


def sensor_file(name: str, what: str, source: str, records: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> str:
    """Effect of slot sensor: per record its name, times s and the temperature K that `what` makes there."""
    head = _head(
        what=f"Temperature that a missing {what} makes",
        slot="sensor",
        name=name,
        formula="theta_sensor = theta + scale T(t)",
        source=source,
        imports=_SCENE,
    )
    rows = []
    for record, time, rise in records:
        text = "np.array(" + np.array2string(np.stack([time, rise]), separator=", ", precision=6, threshold=10**9, max_line_width=120) + ")"
        rows.append(f"{record!r}: {text},")
    tables = (
        "RISE = {\n"
        + indent("\n".join(rows), "    ")
        + '\n}\n"""By record: times in s, and the temperature that is missing there in K."""\n'
    )
    body = '''

def sensor(theta: np.ndarray, scene: Scene, scale: float) -> np.ndarray:
    """Temperature of the model and what is missing, K (n_t, n_s)."""
    if scene.name not in RISE:
        return np.asarray(theta + 0.0 * scale)
    time, rise = RISE[scene.name]
    return np.asarray(theta + scale * np.interp(scene.time, time, rise)[:, None])
'''
    return head + tables + body


VARIABLES = {
    "accumulated plastic strain": "accumulated",
    "temperature": "theta",
    "logarithm of the plastic strain rate": "np.log(1e-12 + rate)",
}
"""State variables that a yield stress may be a table of, as an effect file writes them."""


def yield_file(name: str, source: str, variable: str, steps: tuple[np.ndarray, float, np.ndarray]) -> str:
    """Effect of slot yield_stress: smooth steps of given heights in MPa at edges of a state variable, all of one width; `steps` = (edges,
    width, heights)."""
    edges, width, heights = steps
    head = _head(
        what=f"Yield stress over {variable}",
        slot="yield_stress",
        name=name,
        formula="sigma_y += scale sum_k height_k (1 + z / sqrt(1 + z^2)) / 2, z = (v - edge_k) / width",
        source=source,
        imports="from typing import Any\n\n" + _NUMPY,
    )
    terms = [
        f"    z = (v - {e:.8g}) / {width:.8g}\n    value = value + {h:.6g} * (0.5 + 0.5 * z / np.sqrt(1.0 + z * z))"
        for e, h in zip(edges, heights, strict=True)
    ]
    body = (
        f'''
def yield_stress(accumulated: float, rate: float, theta: float, law: Any, scale: float) -> float:
    """Steps of the yield stress over {variable}, MPa."""
    v = {VARIABLES[variable]}
    value = 0.0 * v
'''
        + "\n".join(terms)
        + "\n    return scale * value\n"
    )
    return head + body
