"""A user's effect is tried once in its slot: what is wrong with it is said by file and reason, and what is right passes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thermofit.core import parameters
from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.unlisted_effect import camera_file, heat_file, sensor_file
from thermofit.effects import catalogue
from thermofit.effects.catalogue import HEAT, KINEMATICS, LOAD, MEASUREMENT, Effect, effect, effects, load_effect
from thermofit.experiment.missing import Grid
from thermofit.identify import user_effects
from thermofit.identify.user_effects import trial_of, try_effect
from thermofit.law.composition import law_effects
from thermofit.law.page import law_of

OUTSIDE = effects((*HEAT, *LOAD, *KINEMATICS, *MEASUREMENT))
ARGUMENTS = {
    "heat_source": "theta, accumulated, rate, time, x, y",
    "of place": "time, x, y",
    "surface_flux": "theta, time, surroundings",
    "boundary_temperature": "y, time, elapsed",
    "capacity": "theta, theta_ref",
    "initial_temperature": "x, y, length",
    "load": "force, end",
    "kinematics": "u, scene",
    "sensor": "theta, scene",
    "yield_stress": "accumulated, rate, theta, law",
}


@pytest.fixture(autouse=True)
def apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects of these tests are not known to others."""
    monkeypatch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    monkeypatch.setattr(parameters, "OF_EFFECTS", dict(parameters.OF_EFFECTS))


def written(folder: Path, slot: str, result: str) -> Path:
    """The file of an effect that returns `result`, a formula of its arguments and of the amplitude a; taken into the catalogue. A slot "of
    place" is that of a heat source which depends on place and time alone."""
    path, arguments = folder / "my_effect.py", ARGUMENTS[slot]
    slot = slot_of(slot)
    path.write_text(
        "import numpy as np\nfrom thermofit.core.parameters import Param\n"
        f"SLOT, FORMULA, SOURCE, ON = {slot!r}, 'made up', 'made up', ('air',)\n"
        "PARAMS = (Param('my_effect.a', '1', 0.0, -5.0, 5.0, 0.1, 'amplitude', probe=0.5),)\n"
        f"def {slot}({arguments}, a):\n    return {result}\n"
    )
    load_effect(path)
    return path


def tried(folder: Path, slot: str, result: str) -> None:
    path = written(folder, slot, result)
    try_effect(effect("my_effect"), path, trial_of(slot_of(slot)))


def slot_of(words: str) -> str:
    return "heat_source" if words == "of place" else words


@pytest.mark.parametrize("e", OUTSIDE, ids=lambda e: e.name)
def test_built_in_effects_pass(e: Effect) -> None:
    try_effect(e, Path(e.name), trial_of(e.slot))


@pytest.mark.parametrize("e", law_effects(), ids=lambda e: e.name)
def test_built_in_effects_of_the_law_pass(e: Effect) -> None:
    law = law_of(Parameters.of({"theta_ref": 297.0}))
    try_effect(e, Path(e.name), user_effects.in_the_law(e.slot), lambda arguments, numbers: e.act(*arguments, law, *numbers))


@pytest.mark.parametrize(
    ("slot", "result"),
    [
        ("heat_source", "a * rate * (theta - 297.0) * np.cos(x)"),
        ("surface_flux", "a * (theta - surroundings)"),
        ("boundary_temperature", "a * elapsed + 0.0 * y"),
        ("capacity", "np.exp(a * (theta - theta_ref))"),
        ("initial_temperature", "a * y / length"),
        ("load", "(force * (1.0 + a), end)"),
        ("kinematics", "u + a * scene.position"),
        ("sensor", "scene.lagged(theta, a)"),
        ("of place", "a * time * np.cos(x) * y"),
    ],
)
def test_what_is_right_passes(tmp_path: Path, slot: str, result: str) -> None:
    tried(tmp_path, slot, result)


@pytest.mark.parametrize(
    ("slot", "result", "said"),
    [
        ("sensor", "theta + a * scene.strains", "does not run (AttributeError: 'Scene' object has no attribute 'strains'"),
        ("heat_source", "a * rates", "does not run (NameError"),
        ("load", "force + a, end.missing", "does not run (AttributeError"),
        ("sensor", "theta[0] + a", "of shape (20,) in a trial; expected shape (7, 20)"),
        ("of place", "a * theta", "does not run (NameError"),
        ("of place", "a * time", "of shape () in a trial; expected shape (5, 4)"),
        ("heat_source", "a", "of shape () in a trial; expected shape (5, 4)"),
        ("kinematics", "u[..., 0] + a", "of shape (7, 20) in a trial; expected shape (7, 20, 2)"),
        ("load", "force + a", "of shape (7,) in a trial; expected 2 arrays of shape (7,)"),
        ("capacity", "theta * a", "not off at the neutral value of my_effect.a, 0: it changes the result by 1; expected 1 everywhere"),
        ("surface_flux", "a * theta + 0.1", "it changes the result by 0.1; expected 0 everywhere"),
        ("initial_temperature", "(a + 1.0) * y", "expected 0 everywhere"),
        ("sensor", "theta + a + 1.0", "it changes the result by 1; expected what it was given"),
        ("load", "force, end + 0.1 + a", "expected what it was given"),
        ("sensor", "theta + abs(a)", "loses the derivative by my_effect.a: 0 by complex step, 1 by difference"),
        ("sensor", "theta + float(a)", "does not run with complex numbers, by which derivatives are made (TypeError"),
        ("sensor", "np.real(theta) + a", "loses the derivative by its argument 1"),
        ("surface_flux", "a * np.abs(theta - surroundings)", "loses the derivative by its argument 1"),
        ("heat_source", "a * np.abs(rate) + 0.0 * theta", "loses the derivative by its argument 3"),
        ("boundary_temperature", "np.abs(a) * y", "loses the derivative by my_effect.a"),
        ("load", "force, end - max(a, 0.0)", "does not run with complex numbers"),
        ("capacity", "1.0 + a * np.log(theta - 400.0)", "values that are not finite"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, slot: str, result: str, said: str) -> None:
    with pytest.raises(StudyError) as error:
        tried(tmp_path, slot, result)
    assert said in str(error.value) and f"my_effect.py: function '{slot_of(slot)}'" in str(error.value), error.value


def test_a_source_that_forgets_its_params_is_not_one_of_place(tmp_path: Path) -> None:
    """As many arguments as one of place and time with three Params has: names tell them apart, not the number."""
    path = tmp_path / "my_effect.py"
    others = ", ".join(f"Param('my_effect.{n}', '1', 1.0, -5.0, 5.0, 0.1, 'a number', scan=(1.0,))" for n in "bc")
    path.write_text(
        "import numpy as np\nfrom thermofit.core.parameters import Param\nSLOT, FORMULA, SOURCE = 'heat_source', 'made up', 'made up'\n"
        f"PARAMS = (Param('my_effect.a', '1', 0.0, -5.0, 5.0, 0.1, 'amplitude', probe=0.5), {others})\n"
        "def heat_source(theta, accumulated, rate, time, x, y):\n    return 0.0 * rate * time\n"
    )
    load_effect(path)
    with pytest.raises(StudyError, match="takes 6 positional arguments but 9 were given"):
        try_effect(effect("my_effect"), path, trial_of("heat_source"))


def test_unlisted_terms_pass(tmp_path: Path) -> None:
    """The effect files that a diagnosis writes are such files."""
    grid = Grid(np.array([0.0, 20.0, 45.0]), np.zeros(3, dtype=int), np.array([0.0, 6.0]), np.array([-20.0, 1.0, 20.0]))
    values = np.random.default_rng(0).normal(size=(3, 3, 2))
    texts = {
        "my_heat": heat_file("my_heat", "a test", grid, values, True),
        "my_motion": camera_file("my_motion", "a test", grid, np.stack([values, 2.0 * values], axis=-1)),
        "my_rise": sensor_file("my_rise", "heat source", "a test", [("", np.array([0.0, 50.0]), np.array([0.0, 2.0]))]),
    }
    for name, text in texts.items():
        path = tmp_path / f"{name}.py"
        path.write_text(text)
        found = load_effect(path)
        try_effect(found, path, trial_of(found.slot))


@pytest.mark.parametrize(
    ("result", "said"),
    [
        ("abs(a) * accumulated", "loses the derivative by my_effect.a"),
        ("a + accumulated", "is not off at the neutral value"),
        (
            "a * np.arctan(accumulated)",
            r"for eight points at once \(TypingError: .*'arctan'.*\); expected \+ - \* / \*\* and, of numpy, abs,",
        ),
        ("a * accumulated if rate > 0.0 else 0.0", r"does not compile"),
    ],
)
def test_an_effect_of_the_law_is_tried_as_it_is_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, result: str, said: str) -> None:
    monkeypatch.setattr(user_effects, "CACHE_FOLDER", tmp_path)
    path = written(tmp_path, "yield_stress", result)
    with pytest.raises(StudyError, match=said):
        user_effects.check_effects([path])
    assert not list(tmp_path.glob("tried_*")), "what is refused is asked for again"


@pytest.mark.parametrize(
    "result", ["a * np.tanh(accumulated / 0.1) ** 3", "a * np.arcsinh(rate) + a * accumulated**0.4", "a * 2.0**accumulated"]
)
def test_powers_and_hyperbolic_functions_compile_for_eight_points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, result: str) -> None:
    monkeypatch.setattr(user_effects, "CACHE_FOLDER", tmp_path)
    user_effects.check_effects([written(tmp_path, "yield_stress", result)])
    assert len(list(tmp_path.glob("tried_*"))) == 1


def test_what_passed_is_not_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(user_effects, "CACHE_FOLDER", tmp_path)
    path = written(tmp_path, "sensor", "theta + a")
    user_effects.check_effects([path])
    monkeypatch.setattr(user_effects, "try_effect", None)
    user_effects.check_effects([path])
