"""thermofit: identify thermo-mechanically coupled plasticity from full-field measurements.

In a notebook: `load_study`, `run`, `run_stage`, `open_run`, `open_record`, `Result`, `demo_study`, all of thermofit.library. They are
imported when they are first used, so that `import thermofit` costs nothing.
"""

import importlib

__version__ = "0.1.0"
_LIBRARY = ("Field", "Matrix", "Result", "demo_study", "load_study", "open_record", "open_run", "run", "run_stage")
__all__ = ["__version__", *_LIBRARY]


def __getattr__(name: str) -> object:
    if name in _LIBRARY:
        return getattr(importlib.import_module("thermofit.library"), name)
    raise AttributeError(f"module 'thermofit' has no attribute '{name}'; it gives {', '.join(_LIBRARY)}")


def __dir__() -> list[str]:
    return sorted(__all__)
