"""What a long job says while it runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest


def said_progress(monkeypatch: pytest.MonkeyPatch, module: str) -> list[tuple[str, str, Any]]:
    """The steps that jobs of a module show from now on: description, note and numbers of each."""
    said: list[tuple[str, str, Any]] = []

    @contextmanager
    def shown(description: str, total: float | None) -> Iterator[Any]:
        yield lambda n=1.0, note="", told=None: said.append((description, note, told))

    monkeypatch.setattr(f"{module}.progress", shown)
    return said
