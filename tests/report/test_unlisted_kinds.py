"""Every kind of term that a model may lack has a unit, a name, words and a file of its own."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.diagnose.unlisted import COUNTS
from thermofit.effects.catalogue import load_effect
from thermofit.experiment.missing import KINDS, Grid
from thermofit.experiment.missing_body import FIELDS, OF_CAMERAS, OF_SURFACE
from thermofit.experiment.missing_coupon import OF_INSTRUMENTS
from thermofit.report.unlisted import effect_file, place_in_words

JAWS = tuple(kind for kind in OF_SURFACE if KINDS[kind].alike == "jaws")
AIR = ("flux", "film")
ALIKE = (*OF_SURFACE, *(kind for kinds in OF_CAMERAS.values() for kind in kinds))
OF_RECORDS = tuple(kind for kinds in OF_INSTRUMENTS.values() for kind in kinds)
"""What instruments add to records of coupons; their files hold what it makes of the temperature (test_unlisted_records.py)."""
SLOTS = {
    **dict.fromkeys(JAWS, "boundary_temperature"),
    **dict.fromkeys(("strain", "scale"), "camera"),
    **dict.fromkeys(("offset", "gradient", "clock"), "sensor"),
    **dict.fromkeys(AIR, "surface_flux"),
}


def test_every_kind_is_told() -> None:
    """A unit and words of its own, and hats; those of no place are the ones that a body has of surface and cameras, and records of their
    instruments."""
    assert set(KINDS) == set(COUNTS) == {*FIELDS.values(), *ALIKE, *OF_RECORDS, "stress"}
    assert {name for name, kind in KINDS.items() if kind.alike} == {*ALIKE, *OF_RECORDS} and set(ALIKE) == set(SLOTS)
    assert len({kind.words for kind in KINDS.values()}) == len(KINDS)


@pytest.mark.parametrize("kind", ALIKE)
def test_the_file_of_a_term_of_no_place_loads(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the slot in which it acts, off at nothing; a term that jaws have acts on them."""
    from thermofit.core import parameters
    from thermofit.effects import catalogue

    monkeypatch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    monkeypatch.setattr(parameters, "OF_EFFECTS", dict(parameters.OF_EFFECTS))
    grid = Grid(np.array([0.0, 10.0]), np.zeros(2, dtype=int), np.zeros(1), np.zeros(1))
    field = SimpleNamespace(basis=SimpleNamespace(grid=grid, kind=kind, chosen=range(2)), values=None, proof="proof")
    field.q = np.array([1.0, 2.0, 0.5][: 3 if KINDS[kind].about else 2])
    field.values = field.q[:2].reshape(2, 1, 1, 1)
    here: Any = SimpleNamespace(case=SimpleNamespace(model=SimpleNamespace(missing=SimpleNamespace(records=()))))
    found: Any = SimpleNamespace(field=field, law=None, channel="dtheta")
    file = effect_file("a study", here, found)
    assert file is not None and file.name == f"unlisted_{kind}" and file.proof == "proof" and KINDS[kind].words in file.words
    path = tmp_path / f"{file.name}.py"
    path.write_text(file.text, encoding="utf-8")
    effect = load_effect(path)
    assert effect.slot == SLOTS[kind] and effect.on == (("clamp",) if kind in JAWS else ("air",) if kind in AIR else ())


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ({"jaws": "all"}, "in both"),
        ({"jaws": "upper"}, "in one"),
        ({"image": "all"}, "in all of the image"),
        ({"image": "all", "middle_mm": 3.14159}, "in all of the image, nothing at y = 3.14 mm,"),
        ({"surface": "all"}, "the same everywhere"),
    ],
)
def test_where_it_is_in_words(where: dict[str, Any], words: str) -> None:
    assert place_in_words(where) == words
