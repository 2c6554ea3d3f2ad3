"""Is a user's effect fit for use? Asked once per file, before anything runs: else it would be said in pages, from the midst of a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.core.digest import file_digest
from thermofit.core.errors import StudyError
from thermofit.core.jit import CACHE_FOLDER, kernel
from thermofit.effects.catalogue import MATERIAL, Effect, effect
from thermofit.identify.effect_trial import Act, Trial, trial_of, try_effect


def check_effects(files: Sequence[Path]) -> None:
    """Try every effect in its slot, those of the law compiled. StudyError names file and reason."""
    for path in files:
        found = effect(path.stem)
        seen = Path(CACHE_FOLDER) / f"tried_{file_digest(path)[:16]}"
        if not seen.exists():
            if found.slot in MATERIAL:
                _try_in_the_law(found, path)
            else:
                try_effect(found, path, trial_of(found.slot))
            seen.touch()


_OFF = {
    "yield_stress": 0.0,
    "yield_factor": 1.0,
    "dissipation": 1.0,
    "free_energy": 1.0,
    "elasticity": 1.0,
    "asymmetry": 1.0,
    "backstress": (0.0, np.nan),
}
"""Result of an effect of the law that is off; the recall of a backstress whose modulus is zero may be anything."""


def state_of(slot: str) -> tuple[float, ...]:
    """What an effect of the law is called with before the law and its Params: Lambda, its rate 1/s and theta K, one of them, or the sense
    of flow."""
    return {"free_energy": (0.01,), "elasticity": (300.0,), "asymmetry": (-0.7,)}.get(slot, (0.01, 1e-3, 300.0))


def in_the_law(slot: str) -> Trial:
    """The trial of a slot of the law."""
    state = state_of(slot)
    return Trial(state, {k: 0.01 * x for k, x in enumerate(state)}, np.array(_OFF[slot]))


def _try_in_the_law(found: Effect, path: Path) -> None:
    from thermofit.core.parameters import Parameters
    from thermofit.law.page import law_of
    from thermofit.law.page_rates import moved_law

    law = law_of(Parameters.of({"theta_ref": 297.0}))
    state = state_of(found.slot)
    # Not kept: what is kept of a function refers to its module by name, and a user's file is none that can be imported.
    function = kernel(forceinline=True, cache=False)(found.act)

    def act(arguments: Sequence[Any], numbers: Sequence[Any]) -> Any:
        """Kernels see real numbers only, or complex ones only."""
        if any(np.iscomplexobj(v) for v in (*arguments, *numbers)):
            return function(*(complex(x) for x in arguments), moved_law(law, -1), *(complex(x) for x in numbers))
        return function(*(float(x) for x in arguments), law, *(float(x) for x in numbers))

    _compile(found, path, act, state)
    try_effect(found, path, in_the_law(found.slot), act)


def _compile(found: Effect, path: Path, act: Act, state: Sequence[float]) -> None:
    values = tuple(float(p.neutral if p.probe is None else p.probe) for p in found.params)
    kinds: tuple[Callable[[float], Any], ...] = (float, complex)
    try:
        for kind in kinds:
            act(state, tuple(kind(v) for v in values))
    except Exception as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip() and not line.startswith("Failed in")]
        reason = f"{type(error).__name__}: {lines[0] if lines else 'no reason given'}"
        raise StudyError(
            f"{path}: function '{found.slot}' does not compile ({reason}); expected numpy functions of numbers that may be complex, and no "
            "'if' on its arguments"
        ) from error
