"""Which files stand in the slots of the base law."""

from __future__ import annotations

from typing import NamedTuple


class Slots(NamedTuple):
    """Hardening law (law.hardening) and yield surface (law.surface), each by name or number."""

    hardening: int | str = 2
    surface: int | str = "hill"
