"""Does a user's effect compile? Asked once per file, before any kernel is: numba would say it in pages, from the midst of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from thermofit.core.digest import file_digest
from thermofit.core.errors import StudyError
from thermofit.core.jit import CACHE_FOLDER, kernel
from thermofit.effects.catalogue import MATERIAL, Effect, effect


def check_compiles(files: Sequence[Path]) -> None:
    """Compile the function of every effect of the law, for real numbers and for complex ones. StudyError names file and reason."""
    for path in files:
        found = effect(path.stem)
        seen = Path(CACHE_FOLDER) / f"compiles_{file_digest(path)[:16]}"
        if found.slot in MATERIAL and not seen.exists():
            _try(found, path)
            seen.touch()


def _try(found: Effect, path: Path) -> None:
    from thermofit.core.parameters import Parameters
    from thermofit.material.law import law_of
    from thermofit.material.law_rates import moved_law

    law = law_of(Parameters.of({"theta_ref": 297.0}))
    values = tuple(float(p.neutral if p.probe is None else p.probe) for p in found.params)
    state = (0.01,) if found.slot == "free_energy" else (0.01, 1e-3, 300.0)
    # Not kept: what is kept of a function refers to its module by name, and a user's file is none that can be imported.
    function = kernel(forceinline=True, cache=False)(found.act)
    try:
        function(*state, law, *values)
        function(*(complex(x) for x in state), moved_law(law, -1), *(complex(x) for x in values))
    except Exception as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip() and not line.startswith("Failed in")]
        reason = f"{type(error).__name__}: {lines[0] if lines else 'no reason given'}"
        raise StudyError(
            f"{path}: function '{found.slot}' does not compile ({reason}); expected numpy functions of numbers that may be complex, and no "
            "'if' on its arguments"
        ) from error
