"""Free expansion of a specimen by temperatures that are added."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.experiment.free_expansion import sections_of

X, Y, Z = (v.ravel() for v in np.meshgrid([0.0, 5.0], np.linspace(0.0, 60.0, 13), [0.0, 1.0], indexing="ij"))
NODES = np.stack([X, Y, Z], axis=1)
ALPHA = 2e-5


def body(nodes: np.ndarray) -> Any:
    return SimpleNamespace(mesh=SimpleNamespace(nodes=nodes))


def test_it_is_the_strain_integrated_from_the_end_that_stays() -> None:
    """Of temperatures that grow linearly along a stretched specimen, exactly: alpha y^2 / 2 per K/mm; across alpha dtheta x."""
    sections = sections_of(body(NODES))
    assert sections is not None and len(sections.count) == 13
    stretched = NODES * np.array([0.9, 1.2, 1.0])
    warmer = np.column_stack([0.1 * stretched[:, 1], np.full(len(NODES), 3.0)])
    moved = sections.expansion(stretched, warmer, ALPHA)
    assert moved[:, 1, 0] == pytest.approx(ALPHA * 0.05 * stretched[:, 1] ** 2, abs=1e-12)
    assert moved[:, 1, 1] == pytest.approx(ALPHA * 3.0 * stretched[:, 1])
    assert moved[:, 0, 1] == pytest.approx(ALPHA * 3.0 * stretched[:, 0]) and not moved[:, 2].any()
    assert not moved[Y == 0.0, 1].any()


def test_a_section_expands_by_its_mean() -> None:
    sections = sections_of(body(NODES))
    assert sections is not None
    uneven = np.where(X > 0.0, 2.0, 0.0)[:, None]
    assert sections.expansion(NODES, uneven, ALPHA)[:, 1, 0] == pytest.approx(ALPHA * Y)


def test_a_mesh_that_is_not_made_of_rows_has_no_sections() -> None:
    rng = np.random.default_rng(1)
    assert sections_of(body(NODES + np.array([0.0, 1.0, 0.0]) * rng.normal(size=(len(NODES), 1)))) is None
