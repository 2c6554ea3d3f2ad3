"""The error of the mesh: what extrapolation takes out of a coarse model, and that all parts of the joint problem see the same data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from virtual_pulls import TRUTH, data, study

from thermofit.core.parameters import Parameters
from thermofit.experiment.discretisation import MESH, corrected, finer_mesh
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.observe.observation import FieldObservation
from thermofit.study.section import MeshSize

COARSE, FINE = MeshSize(n_x=3, n_y=20, n_z=1), MeshSize(n_x=8, n_y=56, n_z=3)


def _rms(a: np.ndarray) -> float:
    return float(np.sqrt(np.mean(a**2)))


def joint(free: tuple[str, ...], parameters: Parameters) -> Joint:
    """The pulled test on a coarse mesh, as a fine one shows it, with the noise of the cameras."""
    plain = Joint(study(), data(), joint_settings(study(), free, data()), COARSE)
    _, error = replace(plain, size=FINE).shown(parameters)
    random = np.random.default_rng(1)

    def seen(o: FieldObservation) -> FieldObservation:
        return replace(o, value=o.value + error[o.name] + o.sigma * random.normal(size=o.value.shape))

    assert plain.data.temperature is not None
    return replace(plain, data=replace(plain.data, displacement=seen(plain.data.displacement), temperature=seen(plain.data.temperature)))


def test_the_corrected_model_shows_what_a_fine_mesh_would() -> None:
    """A good part of the error is gone in every channel, and what is left is about the part that is not trusted to be gone, or less."""
    parameters = Parameters.of(TRUTH, ("E",))
    here = joint(("E",), parameters)
    found = corrected(here, parameters)
    plain, after = here.model.residual(parameters), found.joint.model.residual(parameters)
    fine = replace(here, size=FINE).model.residual(parameters)
    begin = 0
    for c in here.model.comparisons:
        rows = slice(begin, begin + c.n)
        was, left = _rms(plain[rows] - fine[rows]), _rms(after[rows] - fine[rows])
        assert left < 0.65 * was, (c.channel, was, left)
        assert left < 1.3 * _rms(found.left[rows]), (c.channel, left, _rms(found.left[rows]))
        begin += c.n
    assert found.shares[MESH] > 0.6
    assert not found.left[begin:].any(), "priors have no mesh"
    assert 0.02 < found.largest_strain < 0.06


def test_data_of_the_same_mesh_stay_as_they_are() -> None:
    parameters = Parameters.of(TRUTH, ("E", "M_y0", "c0"))
    size = MeshSize(n_x=1, n_y=8, n_z=1)
    same = Joint(study(), data(), joint_settings(study(), parameters.free, data()), size)
    found = corrected(same, parameters)
    assert found.shares[MESH] < 0.05 and _rms(found.left) > 0.5
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
