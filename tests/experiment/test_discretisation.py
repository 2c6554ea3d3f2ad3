"""The error of the mesh: what extrapolation takes out of a coarse model, and that all parts of the joint problem see the same data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from said_progress import said_progress
from virtual_pulls import TIME, TRUTH, data, study

from thermofit.body.mesh.planes import longest
from thermofit.body.mesh.specimen import specimen_mesh
from thermofit.core.experiment import Specimen
from thermofit.core.parameters import Parameters
from thermofit.experiment.body import BodyExperiment
from thermofit.experiment.discretisation import (
    MESH,
    OF_TERM,
    STEPS,
    THEIRS,
    WITHIN,
    corrected,
    finer_mesh,
    left_by,
    numerical_errors,
    on_mesh,
    shares_held,
    telling_mesh,
)
from thermofit.experiment.fields import LoadSteps, refined
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.many import SeveralExperiments
from thermofit.experiment.missing import MissingTerm
from thermofit.observe.observation import FieldObservation
from thermofit.study.section import MeshSize

COARSE, FINE = MeshSize(n_x=3, n_y=20, n_z=1), MeshSize(n_x=8, n_y=56, n_z=3)


def _rms(a: np.ndarray) -> float:
    return float(np.sqrt(np.mean(a**2)))


def joint(free: tuple[str, ...], parameters: Parameters, size: MeshSize = FINE, noise: float = 1.0) -> Joint:
    """The pulled test on a coarse mesh, as another one shows it to cameras of `noise` times the usual noise."""
    plain = Joint(study(), data(), joint_settings(study(), free, data()), COARSE)
    _, error = replace(plain, size=size).shown(parameters)
    random = np.random.default_rng(1)

    def seen(o: FieldObservation) -> FieldObservation:
        sigma = noise * o.sigma
        return replace(o, value=o.value + error[o.name] + sigma * random.normal(size=o.value.shape), sigma=sigma)

    assert plain.data.temperature is not None
    return replace(plain, data=replace(plain.data, displacement=seen(plain.data.displacement), temperature=seen(plain.data.temperature)))


def test_the_corrected_model_shows_what_a_fine_mesh_would(monkeypatch: pytest.MonkeyPatch) -> None:
    """A good part of the error is gone in every channel, and what is left is about the part that is not trusted to be gone, or less. It
    takes minutes on a body, and says what it is at."""
    said = said_progress(monkeypatch, "thermofit.experiment.discretisation")
    parameters = Parameters.of(TRUTH, ("E",))
    here = joint(("E",), parameters)
    found = corrected(here, parameters)
    assert said == [("errors of force, mesh and steps", of, None) for of in ("of the force", "of mesh and steps")]
    plain, after = here.model.residual(parameters), found.joint.model.residual(parameters)
    fine = replace(here, size=FINE).model.residual(parameters)
    begin = 0
    for c in here.model.comparisons:
        rows = slice(begin, begin + c.n)
        was, left = _rms(plain[rows] - fine[rows]), _rms(after[rows] - fine[rows])
        assert left < 0.65 * was, (c.channel, was, left)
        assert left < 1.3 * _rms(found.left[rows]), (c.channel, left, _rms(found.left[rows]))
        begin += c.n
    assert not found.left[begin:].any(), "priors have no mesh"
    assert 0.02 < found.largest_strain < 0.06


def test_shares_are_those_of_the_mesh_that_the_data_are_of() -> None:
    """Of a far finer mesh they are nearly those of a specimen, of the one that tells the error those that make just their difference. The
    cameras are better ones: with the usual noise, an error of five times its length tells its share to 0.2."""
    parameters = Parameters.of(TRUTH, ("E",))
    fine = corrected(joint(("E",), parameters, noise=0.1), parameters).shares
    assert fine[MESH] > 0.6 and fine[WITHIN] > 0.7 and fine[THEIRS] < 0.3, fine
    here = joint(("E",), parameters, finer_mesh(COARSE), noise=0.01)
    found = corrected(here, parameters)
    assert abs(found.shares[MESH] - (1.0 - left_by(COARSE, finer_mesh(COARSE)))) < 0.02 and found.shares[STEPS] < 0.02, found.shares
    assert abs(found.shares[WITHIN] - 1.0) < 0.05 and abs(found.shares[THEIRS] - 1.0) < 0.15, found.shares
    was, left = here.model.residual(parameters), found.joint.model.residual(parameters)
    assert _rms(was) > 5.0 and _rms(left) < 1.2, "the noise is left"


def test_the_share_of_the_smooth_error_is_not_that_of_arcs() -> None:
    """Zigzag arcs that are longer than the smooth part; what the parameters take up counts for nothing."""
    n, random = 4000, np.random.default_rng(8)
    place = np.arange(n)
    fitted = np.column_stack([np.ones(n), place / n])
    smooth, arcs = np.sin(place / 300.0) + 5.0 * fitted[:, 1], 1.5 * np.where(place % 2 == 0, 1.0, -1.0)
    told = {MESH: smooth, WITHIN: arcs, THEIRS: np.roll(arcs, 1) * (place % 3 == 0), STEPS: 0.001 * smooth}
    residual = 0.8 * smooth + arcs + random.normal(size=n)
    whole = {"du": slice(0, n)}
    found = shares_held(told, residual, fitted, whole)
    assert abs(found[MESH] - 0.8) < 0.05 and found[WITHIN] > 0.95 and found[THEIRS] < 0.05
    assert found[STEPS] == 1.0, "too small to tell"
    assert shares_held(told, -0.1 * residual, fitted, whole)[MESH] == 0.0
    few = shares_held({part: 0.01 * rows for part, rows in told.items()}, random.normal(size=n), fitted, whole)
    assert few == {MESH: 1.0, WITHIN: 1.0, THEIRS: 0.0, STEPS: 1.0}, "as of a specimen"


def test_the_share_of_the_mesh_is_not_that_of_a_term_whose_error_is_told_too_large() -> None:
    """Displacements hold all of the mesh's error, temperatures three tenths of what is told of that of a spot, which is far larger. With
    one share for both, hardly more than that would be held of either."""
    n, random = 4000, np.random.default_rng(8)
    place = np.arange(n)
    in_u = place < n // 2
    smooth, spot = np.where(in_u, np.sin(place / 300.0), 0.0), np.where(in_u, 0.0, 8.0 * np.sin(place / 40.0))
    residual = smooth + 0.3 * spot + random.normal(size=n)
    places, fitted = {"du": slice(0, n // 2), "dtheta": slice(n // 2, n)}, np.ones((n, 1))
    found = shares_held({MESH: smooth, OF_TERM: spot}, residual, fitted, places)
    assert abs(found[MESH] - 1.0) < 0.05 and abs(found[OF_TERM] - 0.3) < 0.02
    assert shares_held({MESH: smooth + spot}, residual, fitted, places)[MESH] < 0.35


def test_a_channel_that_misses_something_tells_nothing_of_the_mesh() -> None:
    """Displacements hold eight tenths of an error; temperatures hold the opposite of it, and far more. Where both miss something, the data
    are taken for those of a specimen."""
    n, random = 4000, np.random.default_rng(8)
    place = np.arange(n)
    smooth = np.sin(place / 300.0)
    told, fitted = {MESH: smooth, STEPS: 0.001 * smooth}, np.ones((n, 1))
    missing = np.where(place < n // 2, 0.8 * smooth, -5.0 * smooth + 3.0 * np.sign(np.sin(place / 90.0)))
    residual = missing + 0.5 * random.normal(size=n)
    places = {"du": slice(0, n // 2), "dtheta": slice(n // 2, n)}
    assert abs(shares_held(told, residual, fitted, places)[MESH] - 0.8) < 0.1
    assert shares_held(told, residual, fitted, {"both": slice(0, n)})[MESH] == 1.0
    residual[: n // 2] += 4.0 * np.sign(np.sin(place[: n // 2] / 50.0))
    assert shares_held(told, residual, fitted, places) == {MESH: 1.0, STEPS: 1.0}


def test_a_term_that_the_model_lacks_tells_no_shares_beside_it() -> None:
    """Where it is given, the shares are those of data without it, however much it adds; else it is taken for an error."""
    parameters = Parameters.of(TRUTH, ("E",))
    here = joint(("E",), parameters, finer_mesh(COARSE), noise=0.1)
    seen = here.data.temperature
    assert seen is not None and here.model.missing is not None
    adds = 0.01 * np.sin(seen.time / 20.0)[:, None, None] * np.ones(seen.value.shape)
    warm = replace(here, data=replace(here.data, temperature=replace(seen, value=seen.value + adds)))
    grid = here.model.missing.grid("offset", (320, 1, 1))
    term = MissingTerm("offset", grid, np.arange(grid.size), np.zeros(grid.size))
    clean, told = corrected(here, parameters, term).shares, corrected(warm, parameters, term).shares
    assert all(abs(told[part] - clean[part]) < 1e-9 for part in clean)
    right, wrong = corrected(here, parameters).shares, corrected(warm, parameters).shares
    assert max(abs(wrong[part] - right[part]) for part in right) > 0.02, wrong


def test_arcs_stay_with_their_mesh() -> None:
    whole = {MESH: 5.0, OF_TERM: 3.0, WITHIN: 100.0, THEIRS: 1000.0, STEPS: 1.0}
    fields = {part: {"u": np.array([k])} for part, k in whole.items()}
    twice = MeshSize(n_x=6, n_y=40, n_z=2)
    assert np.allclose(on_mesh(fields, COARSE, twice)["u"], 2.0 + 1000.0 + 1.0)
    assert np.allclose(on_mesh(fields, COARSE, COARSE)["u"], 1109.0)


def test_parts_of_the_error_of_the_mesh_are_in_doubt_each_by_itself() -> None:
    """Half of each that the data hold, in a row of its own: what they make of a parameter does not cancel in a budget."""
    parameters = Parameters.of(TRUTH, ("E", "c0"))
    here = joint(("E", "c0"), parameters, noise=0.1)
    found, model = corrected(here, parameters), here.model
    doubts = found.doubt(False)
    assert set(doubts) == {MESH, WITHIN, THEIRS, STEPS}
    at = here.shown(parameters)[1]
    for part in (MESH, WITHIN):
        held = model.assemble(at) - model.assemble({name: at[name] - error for name, error in found.fields[part].items()})
        rows = slice(0, sum(c.n for c in model.comparisons))
        assert _rms(held) > 0.0 and np.allclose(doubts[part][rows], 0.5 * held[rows], rtol=0.0, atol=0.02 * np.abs(held).max()), part
    assert not found.causes[THEIRS].any(), "a specimen has no elements"


def test_data_of_the_same_mesh_stay_as_they_are() -> None:
    parameters = Parameters.of(TRUTH, ("E", "M_y0", "c0"))
    size = MeshSize(n_x=1, n_y=8, n_z=1)
    same = Joint(study(), data(), joint_settings(study(), parameters.free, data()), size)
    found = corrected(same, parameters)
    assert found.shares[MESH] < 0.05 and _rms(found.left) > 0.5
    assert _rms(found.doubt(False)[MESH]) < 0.1 * _rms(found.causes[MESH]), "what the data do not hold is in no doubt"
    change = found.joint.model.residual(parameters) - same.model.residual(parameters)
    assert _rms(change) < 0.1 * _rms(found.left)


def test_displacements_alone_and_temperatures_alone_see_the_corrected_data() -> None:
    parameters = Parameters.of(TRUTH, ("E", "c0"))
    found = corrected(joint(("E", "c0"), parameters), parameters).joint
    both = found.model.residual(parameters)
    mechanics, heat = found.mechanics, found.heat(parameters)
    assert mechanics is not None and heat is not None
    n = sum(c.n for c in mechanics.comparisons)
    assert np.allclose(mechanics.residual(parameters)[:n], both[:n], atol=1e-6)
    assert np.allclose(heat.residual(parameters)[: len(both) - n], both[n:], atol=0.02)


def test_a_finer_mesh_is_finer_along_every_axis() -> None:
    assert finer_mesh(MeshSize(n_x=6, n_y=40, n_z=1)) == MeshSize(n_x=9, n_y=60, n_z=2)
    assert finer_mesh(MeshSize(n_x=2, n_y=14, n_z=1)) == MeshSize(n_x=3, n_y=22, n_z=2), "an even number along the load"


def test_the_mesh_that_tells_an_error_is_finer_in_the_jaws_too() -> None:
    """A grip that is longer than what the jaws hold: half as many elements again leave one in the jaws. Where all of the grip is held, or
    its elements are shorter than those outside, the finer mesh does."""
    size = MeshSize(n_x=4, n_y=28, n_z=1)
    case, held = study(), Specimen(20.0, 1.5, 80.0, 20.0, 30.0, 150.0, 10.0)
    lengths = {n: longest(specimen_mesh(case.geometry, held, MeshSize(n_x=2, n_y=n, n_z=1)))[0] for n in (28, 42, 48)}
    assert lengths == pytest.approx({28: 10.0, 42: 10.0, 48: 5.0})
    told = telling_mesh(case, held, size)
    assert told == MeshSize(n_x=6, n_y=48, n_z=2) and left_by(size, told) == pytest.approx(4 * 28 / (6 * 48))
    whole = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
    assert telling_mesh(case, whole, size) == finer_mesh(size) == MeshSize(n_x=6, n_y=42, n_z=2)
    assert telling_mesh(case, replace(held, gripped_length=2.0), size) == finer_mesh(size)


def test_an_experiment_knows_the_mesh_that_tells_the_error_of_its_own() -> None:
    """`verify --refine` compares with it; of several it is that of the specimen that needs the most."""
    size, case = MeshSize(n_x=4, n_y=28, n_z=1), study()
    plain = BodyExperiment(case, given=data())
    held = BodyExperiment(case, given=replace(data(), specimen=Specimen(20.0, 1.5, 80.0, 20.0, 30.0, 150.0, 10.0)))
    assert plain.finer(size) == MeshSize(n_x=6, n_y=42, n_z=2) and held.finer(size) == MeshSize(n_x=6, n_y=48, n_z=2)
    assert SeveralExperiments(case, (plain, held)).finer(size) == held.finer(size)


def test_the_error_of_one_element_in_the_jaws_is_told() -> None:
    """That of the temperatures is what a far finer mesh says of it within three tenths: 0.22, and 0.36 by a mesh with one there too."""
    parameters = Parameters.of(TRUTH, ("alpha_clamp",))
    held = Specimen(20.0, 1.5, 80.0, 20.0, 30.0, 150.0, 10.0)
    plain = replace(joint(("alpha_clamp",), parameters), size=MeshSize(n_x=2, n_y=28, n_z=1))
    here = replace(plain, data=replace(plain.data, specimen=held))
    history, coarse = here.shown(parameters)
    _, fine = replace(here, size=MeshSize(n_x=4, n_y=96, n_z=2)).shown(parameters)
    told = numerical_errors(here, parameters, history, coarse)[MESH]["theta"]
    true = here.smoothed(history, parameters)["theta"] - fine["theta"]
    assert _rms(told - true) < 0.3 * _rms(true), (_rms(told), _rms(true), _rms(told - true))


def bending(time: np.ndarray) -> np.ndarray:
    """A force N that bends as that of a hardening metal does at a constant speed of the crosshead, up to 5200 N, and falls again."""
    loaded = 3900.0 + 1300.0 * (1.0 - np.exp(-(time - 6.0) / 9.0)) / (1.0 - np.exp(-24.0 / 9.0))
    back = np.interp(time, [30.0, 40.0], [5200.0, 1000.0])
    return np.where(time < 6.0, np.interp(time, [2.0, 6.0], [0.0, 3900.0]), np.where(time < 30.0, loaded, back))


def under(steps: LoadSteps) -> Joint:
    """The pulled test under a force that bends."""
    held = replace(data(), steps=dict.fromkeys(data().steps, steps))
    return Joint(study(), held, joint_settings(study(), ("E",), data()), COARSE)


def test_the_error_of_the_steps_is_that_of_a_force_that_bends_between_them() -> None:
    """Against a run whose sixteen times as many steps go along the force itself. Along the chords of the whole steps the specimen deforms
    later, its heat has less time to leave, and halved steps tell an error that whole ones do not make."""
    parameters, fine = Parameters.of(TRUTH, ("E",)), refined(TIME, 16)
    whole = LoadSteps(TIME, bending(TIME), course=(fine, bending(fine)))
    here, right = under(whole), under(LoadSteps(fine, bending(fine)))
    made = here.shown(parameters)[1]["theta"] - right.shown(parameters)[1]["theta"]
    flows = (here.model.observations["theta"].time > 6.0) & (here.model.observations["theta"].time <= 30.0)

    def off(steps: LoadSteps) -> float:
        problem = under(steps)
        told = numerical_errors(problem, parameters, *problem.shown(parameters))[STEPS]["theta"]
        return _rms(told[flows] - made[flows]) / _rms(made[flows])

    assert off(whole) < 0.3
    assert off(replace(whole, course=None)) > 3.0 * off(whole), "the chord would tell another error"


def test_steps_in_parts_go_along_the_course_of_the_force() -> None:
    fine = np.linspace(0.0, 40.0, 401)
    steps = LoadSteps(TIME, bending(TIME), 2.0 * TIME, None, TIME[:, None], (fine, bending(fine)))
    parts = steps.divided(2).until(20.0).divided(2)
    assert parts.time[-1] == 20.0
    assert parts.force == pytest.approx(np.interp(parts.time, fine, bending(fine)), abs=1e-9)
    assert parts.crosshead == pytest.approx(2.0 * parts.time) and parts.error[:, 0] == pytest.approx(parts.time)
    chords = replace(steps, course=None).divided(2)
    assert chords.force[1::2] == pytest.approx(0.5 * (chords.force[:-1:2] + chords.force[2::2])), "without a course it is straight"


@pytest.mark.parametrize("kind", ["flux", "jaws"])
def test_the_errors_hold_those_of_a_heat_that_the_model_lacks(kind: str) -> None:
    """What comes through the surface goes through the same mesh and steps: with its errors the coarse answer to it is nearer to that of a
    fine mesh, of a flux by a factor of four, of jaws by two. Of a term that heats nothing, they are those without it."""
    parameters = Parameters.of(TRUTH, ("E",))
    here = joint(("E",), parameters, noise=0.1)
    missing = here.model.missing
    assert missing is not None
    grid = missing.grid(kind, (320, 1, 1))
    amount = (0.02 if kind == "flux" else 2.0) * np.sin(2.0 * np.pi * grid.time / 60.0)
    term = MissingTerm(kind, grid, np.arange(grid.size), amount)
    history, coarse = here.shown(parameters)
    plain, told = (numerical_errors(here, parameters, history, coarse, one) for one in (None, term))
    assert all(np.array_equal(told[MESH][name], plain[MESH][name]) for name in coarse) and OF_TERM not in plain, "told apart"
    own = told[OF_TERM]["theta"] + sum(told[part]["theta"] - plain[part]["theta"] for part in (WITHIN, STEPS))
    finest = replace(here, size=FINE, substeps=3)
    exact = finest.warmed_by(term, finest.shown(parameters)[0], parameters)
    off = here.warmed_by(term, history, parameters) - exact
    assert _rms(off - own) < (0.4 if kind == "flux" else 0.6) * _rms(off)
    grid = missing.grid("scale", (320, 1, 1))
    image = MissingTerm("scale", grid, np.arange(grid.size), np.ones(grid.size))
    of_image = numerical_errors(here, parameters, history, coarse, image)
    assert set(of_image) == set(plain) and all(np.array_equal(of_image[MESH][n], plain[MESH][n]) for n in coarse)
