"""The hardening curve of the base law, for effects that act on it; what it is the room of the law says (law.composition)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_given: list[Callable[[Any, Any], Any]] = []


def hardening(accumulated: Any, law: Any) -> Any:
    """Yield stress of the base law in MPa after the plastic multiplier Lambda of monotonic flow, without effects and without H_lin Lambda.

    To be called in the function of an effect, with its `law`; inside kernels it is compiled with them.
    """
    return _given[-1](accumulated, law)


def give(function: Callable[[Any, Any], Any]) -> None:
    """Say what `hardening` is outside kernels."""
    _given[:] = [function]
