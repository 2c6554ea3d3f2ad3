"""Is a user's effect fit for use? Asked once per file, before anything runs: else it would be said in pages, from the midst of a run.

One trial of a user's effect in the place where it acts: shapes, neutral is off, derivatives by complex step; before anything runs.

Every slot is called with small made-up fields: probes for the amplitudes, neutral values for the rest, real numbers and complex ones. What
is wrong with a file is said here in one sentence, not from the midst of a fit.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np

from thermofit.core.digest import file_digest
from thermofit.core.errors import StudyError
from thermofit.core.jit import CACHE_FOLDER, kernel
from thermofit.core.lanes import LANES, OF_NUMPY
from thermofit.core.parameters import Param
from thermofit.effects.catalogue import KINEMATICS, LOAD, MATERIAL, MEASUREMENT, Effect, effect
from thermofit.effects.scene import Scene
from thermofit.observe.stations import CAMERA, scene_of

_STEP = 1e-30
_NUDGE = 1e-4
"""Step of differences, in probes of a Param and in slopes of a field."""
_AGREE, _ROUNDING = 1e-2, 1e-12
"""Difference and complex step agree to that part of the largest; and rounding of the difference, in parts of the largest value."""
_NEUTRAL_EFFECT = 1e-9
"""What may be left at neutral, in parts of what the probe does."""
_WANTED = "expected numpy functions that keep complex numbers: no abs(), float(), np.real or comparison of what is calculated"


@dataclass(frozen=True)
class SlotTrial:
    """What a slot is called with before its Params; `slopes` of those arguments, by place, that derivatives are taken along; `off` is the
    result of an effect that does nothing, its parts stacked where the slot returns several (nan: any)."""

    arguments: tuple[Any, ...]
    slopes: dict[int, Any]
    off: np.ndarray


Act = Callable[[Sequence[Any], Sequence[Any]], Any]
"""The function of an effect: what it makes of arguments and values of the Params, all real or some complex."""


def small_scene() -> tuple[np.ndarray, np.ndarray, Scene]:
    """Temperature (7, 20) K and displacement (7, 20, 2) mm of a pulled strip, and its scene; at rest at the first time."""
    x, y = np.meshgrid(np.linspace(-5.0, 5.0, 4), np.linspace(-20.0, 20.0, 5))
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    time = np.array([0.0, 3.1, 7.3, 12.2, 20.9, 31.7, 40.0])
    stretch = np.array([0.0, 0.001, 0.004, 0.01, 0.03, 0.06, 0.055])
    u = np.stack([-0.4 * stretch[:, None] * xy[:, 0], stretch[:, None] * xy[:, 1]], axis=-1)
    theta = 299.0 + (1.0 + 0.02 * xy[:, 0] - 0.03 * xy[:, 1]) * 40.0 * stretch[:, None]
    return theta, u, scene_of(time, xy, u, 1e5 * stretch * (1.0 - 5.0 * stretch), 297.0)


def trial_of(slot: str) -> SlotTrial:
    """The trial of a slot of heat, load, motion or measurement."""
    theta, u, scene = small_scene()
    if slot in (*KINEMATICS, *CAMERA):
        return SlotTrial((u, scene), {0: np.linspace(0.0, 1.0, len(u))[:, None, None] * (0.1 + 0.0 * u)}, u)
    if slot in MEASUREMENT:
        return SlotTrial((theta, scene), {0: np.linspace(0.0, 1.0, len(theta))[:, None] * (1.0 + 0.01 * scene.position[..., 1])}, theta)
    if slot in LOAD:
        force, end = 4000.0 * scene.load, 0.1 + scene.load
        return SlotTrial((force, end), {}, np.stack([force, end]))
    warm, x, y = theta[-1].reshape(5, 4), *(c.reshape(5, 4) for c in np.moveaxis(scene.position[0], -1, 0))
    accumulated, rate = 0.03 + 1e-4 * y, 1e-3 + 1e-5 * x
    flat, across, along = warm.ravel(), x.ravel(), y.ravel()
    arguments: dict[str, tuple[tuple[Any, ...], tuple[int, ...], float]] = {
        "heat_source": ((warm, accumulated, rate, 31.7, x, y), (0, 1, 2), 0.0),
        "surface_flux": ((flat, 31.7, np.full_like(flat, 297.0), along), (0, 2), 0.0),
        "boundary_temperature": ((along, 31.7, 25.0), (), 0.0),
        "axial_temperature": ((along, 400.0), (), 0.0),
        "capacity": ((flat, 297.0), (0, 1), 1.0),
        "conductivity": ((flat, 297.0), (0, 1), 1.0),
        "initial_temperature": ((across, along, 40.0), (), 0.0),
    }
    given, moved, off = arguments[slot]
    return SlotTrial(given, {k: 0.01 * given[k] for k in moved}, np.full_like(given[0], off))


def try_effect(found: Effect, path: Path, trial: SlotTrial, act: Act | None = None) -> None:
    """Run an effect once in its slot; `act` in the stead of its own function. StudyError names file and reason: it does not run, returns
    another shape or no numbers, is not off at neutral, or loses a derivative that is taken by complex step."""
    run = _Run(found, path, trial, act or (lambda arguments, numbers: found.act(*arguments, *numbers)))
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        probed = [p.neutral if p.probe is None else p.probe for p in found.params]
        on = run(trial.arguments, probed)
        off = run(trial.arguments, _neutral(found, probed))
        left = np.nanmax(np.abs(off - trial.off))
        if left > _NEUTRAL_EFFECT * np.nanmax(np.abs(on - trial.off)) + _ROUNDING * np.nanmax(np.abs(trial.off)):
            raise StudyError(
                f"{path}: function '{found.slot}' is not off at the neutral value of {found.amplitude.name}, {found.amplitude.neutral:g}: "
                f"it changes the result by {left:.3g}; expected {_expected_off(trial)}"
            )
        for k, p in enumerate(found.params):
            run.check_param(k, p, probed)
        for k in trial.slopes:
            run.check_argument(k, probed)


def _neutral(found: Effect, numbers: Sequence[float]) -> list[float]:
    """Values of the Params with all amplitudes neutral."""
    return [p.neutral if p in found.amplitudes else value for p, value in zip(found.params, numbers, strict=True)]


def _expected_off(trial: SlotTrial) -> str:
    """What the slot asks of an effect that is off, in words."""
    values = np.unique(trial.off[np.isfinite(trial.off)])
    return f"{values[0]:g} everywhere" if len(values) == 1 else "what it was given"


@dataclass(frozen=True)
class _Run:
    """Calls of one effect in its trial."""

    found: Effect
    path: Path
    trial: SlotTrial
    act: Act

    def __call__(self, arguments: Sequence[Any], numbers: Sequence[Any]) -> np.ndarray:
        """The result, its parts stacked. StudyError where it does not run, or its shape or its values are wrong."""
        moved = any(np.iscomplexobj(v) for v in (*arguments, *numbers))
        given = " with complex numbers, by which derivatives are made" if moved else ""
        where = f"{self.path}: function '{self.found.slot}'"
        try:
            result = self.act(arguments, numbers)
            parts = [np.asarray(part) for part in result] if isinstance(result, tuple) else [np.asarray(result)]
            value = np.stack(parts) if isinstance(result, tuple) else parts[0]
            good = bool(np.all(np.isfinite(value)))
        except Exception as error:
            reason = " ".join(str(error).split())
            raise StudyError(f"{where} does not run{given} ({type(error).__name__}: {reason}); see docs/effects.md") from error
        if value.shape != self.trial.off.shape:
            n = len(self.trial.off) if isinstance(result, tuple) or self.found.slot in LOAD else 0
            shape = f"{n} arrays of shape {self.trial.off.shape[1:]}" if n else f"shape {self.trial.off.shape}"
            raise StudyError(f"{where} returns {type(result).__name__} of shape {value.shape} in a trial; expected {shape}")
        if not good:
            raise StudyError(f"{where} returns values that are not finite in a trial{given}; expected numbers within the bounds of PARAMS")
        return value

    def check_param(self, k: int, p: Param, numbers: Sequence[float]) -> None:
        """The derivative by one Param at the probe; at neutral only that there is one: many effects are one-sided there."""
        for values in (_neutral(self.found, numbers), numbers):
            moved: list[complex] = list(values)
            moved[k] += 1j * _STEP
            found = self(self.trial.arguments, moved).imag / _STEP
        h = _NUDGE * abs(p.probe or p.scale)
        up, down = min(numbers[k] + h, p.upper), max(numbers[k] - h, p.lower)
        ends = [self(self.trial.arguments, [*numbers[:k], x, *numbers[k + 1 :]]) for x in (up, down)]
        self._compare(found, ends, up - down, p.name)

    def check_argument(self, k: int, numbers: Sequence[float]) -> None:
        """The derivative along the slope of one argument."""
        given, slope = self.trial.arguments, self.trial.slopes[k]
        along = [self((*given[:k], given[k] + x * slope, *given[k + 1 :]), numbers) for x in (1j * _STEP, _NUDGE, -_NUDGE)]
        self._compare(along[0].imag / _STEP, along[1:], 2.0 * _NUDGE, f"its argument {k + 1}")

    def _compare(self, found: np.ndarray, ends: Sequence[np.ndarray], apart: float, by: str) -> None:
        expected = (ends[0] - ends[1]) / apart
        wrong = np.abs(found - expected)
        if wrong.max() > _AGREE * np.abs(expected).max() + _ROUNDING * np.abs(ends[0]).max() / apart:
            at = np.unravel_index(int(np.argmax(wrong)), wrong.shape)
            raise StudyError(
                f"{self.path}: function '{self.found.slot}' loses the derivative by {by}: {found[at]:.3g} by complex step, "
                f"{expected[at]:.3g} by difference; {_WANTED}"
            )


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


def in_the_law(slot: str) -> SlotTrial:
    """The trial of a slot of the law."""
    state = state_of(slot)
    return SlotTrial(state, {k: 0.01 * x for k, x in enumerate(state)}, np.array(_OFF[slot]))


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
    _compile_for_eight(found, path, function, law)
    try_effect(found, path, in_the_law(found.slot), act)


def _compile(found: Effect, path: Path, act: Act, state: Sequence[float]) -> None:
    values = tuple(float(p.neutral if p.probe is None else p.probe) for p in found.params)
    kinds: tuple[Callable[[float], Any], ...] = (float, complex)
    try:
        for kind in kinds:
            act(state, tuple(kind(v) for v in values))
    except Exception as error:
        raise StudyError(
            f"{path}: function '{found.slot}' does not compile ({_reason(error)}); expected numpy functions of numbers that may be "
            "complex, and no 'if' on its arguments"
        ) from error


def _compile_for_eight(found: Effect, path: Path, function: Any, law: Any) -> None:
    """As a body calls it: eight points at once, of which numba knows fewer functions than of one."""
    compiled = getattr(function, "compile", None)
    if compiled is None:  # numba is switched off: nothing is compiled
        return
    typeof: Any = numba.typeof
    kinds = (*(LANES,) * len(state_of(found.slot)), typeof(law), *(numba.float64,) * len(found.params))
    try:
        compiled(kinds)
    except numba.core.errors.NumbaError as error:
        raise StudyError(
            f"{path}: function '{found.slot}' does not compile for eight points at once ({_reason(error)}); expected + - * / ** and, of "
            f"numpy, {', '.join(OF_NUMPY)}, and no 'if' on its arguments"
        ) from error


def _reason(error: Exception) -> str:
    """Name of an exception and what it says first that is not where numba was."""
    lines = [re.sub(r"\x1b\[\d+m", "", line).strip() for line in str(error).splitlines()]
    said = next((line for line in lines if line and not line.startswith("Failed in")), "no reason given")
    return f"{type(error).__name__}: {said.rstrip(':')}"
