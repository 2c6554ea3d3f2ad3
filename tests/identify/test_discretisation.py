"""The error of the mesh: what extrapolation takes out of a coarse model, and that all parts of the joint problem see the same data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from test_joint import TRUTH, data, study

from thermofit.core.parameters import Parameters
from thermofit.core.study_section import MeshSize
from thermofit.identify.discretisation import REMAINS, discretised, finer_mesh
from thermofit.identify.joint import Joint, joint_settings

COARSE, FINE = MeshSize(n_x=3, n_y=20, n_z=1), MeshSize(n_x=8, n_y=56, n_z=3)


def _rms(a: np.ndarray) -> float:
    return float(np.sqrt(np.mean(a**2)))


def test_the_corrected_model_shows_what_a_fine_mesh_would() -> None:
    """A good part of the error is gone in every channel, and what is left is about the part that is not trusted to be gone, or less."""
    parameters = Parameters.of(TRUTH, ("E",))
    joint = Joint(study(), data(), joint_settings(study(), ("E",), data()), COARSE)
    found = discretised(joint, parameters)
    plain, corrected = joint.model.residual(parameters), found.joint.model.residual(parameters)
    fine = replace(joint, size=FINE).model.residual(parameters)
    begin = 0
    for c in joint.model.comparisons:
        rows = slice(begin, begin + c.n)
        before, after = _rms(plain[rows] - fine[rows]), _rms(corrected[rows] - fine[rows])
        assert after < 0.65 * before, (c.channel, before, after)
        assert after < 1.3 * _rms(found.left[rows]), (c.channel, after, _rms(found.left[rows]))
        taken = plain[rows] - corrected[rows]
        assert np.allclose(found.left[rows], REMAINS * taken, atol=1e-2 * _rms(taken) + 1e-4)
        begin += c.n
    assert not found.left[begin:].any(), "priors have no mesh"
    assert 0.02 < found.largest_strain < 0.06


def test_displacements_alone_and_temperatures_alone_see_the_corrected_data() -> None:
    parameters = Parameters.of(TRUTH, ("E", "c0"))
    joint = discretised(Joint(study(), data(), joint_settings(study(), ("E", "c0"), data()), COARSE), parameters).joint
    both = joint.model.residual(parameters)
    mechanics, heat = joint.mechanics, joint.heat(parameters)
    assert mechanics is not None and heat is not None
    n = sum(c.n for c in mechanics.comparisons)
    assert np.allclose(mechanics.residual(parameters)[:n], both[:n], atol=1e-6)
    assert np.allclose(heat.residual(parameters)[: len(both) - n], both[n:], atol=0.02)


def test_a_finer_mesh_is_finer_along_every_axis() -> None:
    assert finer_mesh(MeshSize(n_x=6, n_y=40, n_z=1)) == MeshSize(n_x=9, n_y=60, n_z=2)
    assert finer_mesh(MeshSize(n_x=2, n_y=14, n_z=1)) == MeshSize(n_x=3, n_y=22, n_z=2), "an even number along the load"
