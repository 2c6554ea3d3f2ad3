"""One module per subcommand: Records and config in, Record out."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

CHAIN = (
    *("simulate", "calibrate-ir", "interpolate", "identify-elastic", "identify-plastic", "identify-thermal", "refine"),
    *("gridsearch", "sensitivity", "verify", "report"),
)
"""Names of the links of the chain, in their order."""
NECKING_CHAIN = ("necking",)
"""The chain of a necking test."""


def stage_function(name: str) -> Callable[..., Any]:
    """`run(study, *, force) -> Outcome` of a stage by its command, imported when it is needed: numba and scipy cost seconds."""
    function: Callable[..., Any] = importlib.import_module(f"thermofit.stages.{name.replace('-', '_')}").run
    return function
