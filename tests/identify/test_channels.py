"""Every channel of the objective on a body: exact derivatives, weights, windows, masks, any combination."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from virtual_pulls import SIZE, TIME, TRUTH, XY, pulled, study

from thermofit.core.errors import DataError, StudyError
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import Measured
from thermofit.experiment.model import StageModel, stage_model
from thermofit.identify.solve import covariance_of

ALL = "{u: {}, du: {}, strain: {}, force: {}, stress: {}, theta: {}, dtheta: {}}"
MOVED = {"E": 700.0, "M_y0": 0.7, "H_exp": 0.06, "c0": 0.02, "alpha_air": 0.3, "alpha_exp": 2e-7}
DRIVE = "force: {drives: crosshead}\n"


@lru_cache(maxsize=1)
def data() -> Measured:
    set_threads(1)
    return pulled()


def model(channels: str, more: str = "", drive: str = DRIVE) -> StageModel:
    names = ", ".join(MOVED)
    case = study(f"{drive}stages:\n  plastic: {{free: [{names}], channels: {channels}{more}}}\n")
    return stage_model(case, data(), case.stage("plastic"), Parameters.of(TRUTH), SIZE, (0.0, 40.0, ""))


def parts(whole: StageModel) -> dict[str, slice]:
    ends = np.cumsum([0, *(c.n for c in whole.comparisons)])
    return {c.channel: slice(int(a), int(b)) for c, a, b in zip(whole.comparisons, ends[:-1], ends[1:], strict=True)}


@pytest.mark.parametrize(
    "measures",
    ["", ", du: {scheme: gradient, components: [xx, yy, xy]}, strain: {measure: green-lagrange}", ", du: {scheme: neighbour}"],
    ids=["rigid-body and technical", "gradient and Green-Lagrange", "neighbour"],
)
def test_jacobian_of_every_channel_is_exact(measures: str) -> None:
    """The remainder of the first order falls with the square of the step, in every channel by itself."""
    whole, names = model(ALL, measures), tuple(MOVED)
    base, step = Parameters.of(TRUTH), np.array(list(MOVED.values()))
    residual, jacobian = whole.linearised(base, names)
    left = []
    for h in (1.0, 0.5, 0.25):
        moved = base.replace(**{n: base[n] + h * d for n, d in zip(names, step, strict=True)})
        left.append(whole.residual(moved) - residual - h * jacobian @ step)
    for channel, part in parts(whole).items():
        size = [float(np.linalg.norm(r[part])) for r in left]
        first = float(np.linalg.norm((jacobian @ step)[part]))
        assert first > 0.1 and size[0] < 0.1 * first, channel
        order = np.log2(np.array(size[:-1]) / np.array(size[1:]))
        assert np.all(np.abs(order - 2.0) < 0.15), (channel, order, size, first)


def test_stress_is_force_over_area_and_needs_a_displacement_that_drives() -> None:
    whole = model("{force: {}, stress: {}}")
    r = whole.residual(Parameters.of(TRUTH).replace(M_yinf=280.0))
    part = parts(whole)
    np.testing.assert_allclose(r[part["force"]], r[part["stress"]], rtol=1e-12)
    assert whole.comparisons[1].unit == "MPa" and whole.comparisons[1].sigma[0] == pytest.approx(4.0 / 30.0)
    with pytest.raises(StudyError, match=r"channel stress needs force\.drives"):
        model("{stress: {}}", drive="")


def test_green_lagrange_differs_from_technical_by_second_order() -> None:
    """At 1 % of strain the squares matter by half a percent; both vanish where model and data agree."""
    channel = "{strain: {weight: 1.0}}"
    technical, large = (model(channel, f", strain: {{measure: {m}, components: [yy]}}") for m in ("technical", "green-lagrange"))
    away = Parameters.of(TRUTH).replace(H_exp=9.0)
    a, b = technical.residual(away), large.residual(away)
    grown = np.abs(a) > 1e-3
    assert grown.sum() > 20
    ratio = b[grown] / a[grown]
    strain = np.polyfit(XY[:, 1], data().displacement.value[9, :, 1], 1)[0]
    assert ratio.max() == pytest.approx(1.0 + strain, abs=0.02) and strain > 0.02


def test_balanced_channels_weigh_alike_however_many_values_they_have() -> None:
    balanced = model("{du: {weight: balanced}, force: {weight: balanced}, dtheta: {}}")
    plain = model("{du: {}, force: {}, dtheta: {}}")
    part, base = parts(plain), Parameters.of(TRUTH).replace(M_y0=131.0)
    r, before = balanced.residual(base), plain.residual(base)
    ratio = {c: float((r[p] @ r[p]) / (before[p] @ before[p])) for c, p in part.items()}
    n = {c: p.stop - p.start for c, p in part.items()}
    assert ratio["dtheta"] == pytest.approx(1.0)
    assert ratio["du"] * n["du"] == pytest.approx(ratio["force"] * n["force"]) == pytest.approx((n["du"] + n["force"]) / 2)


def test_standard_errors_know_what_a_weight_does_not_say() -> None:
    """The least squares estimate under manual weights has the variance of the data, whatever the unit of the weight."""
    rng, base = np.random.default_rng(3), Parameters.of(TRUTH)
    names = ("E", "M_y0")
    sigma = {}
    for weight in ("sigma", "{x: 1.0, y: 2500.0}", "{x: 100.0, y: 250000.0}", "value"):
        whole = model(f"{{u: {{weight: {weight}}}}}")
        _, jacobian = whole.linearised(base, names)
        c = whole.comparisons[0]
        drawn = rng.normal(size=(400, c.n)) * c.spread
        found = -drawn @ np.linalg.pinv(jacobian).T
        fit = type("Fit", (), {"jacobian": jacobian, "residual": drawn[0], "names": names, "at_bound": np.zeros(2, dtype=bool)})
        covariance, _ = covariance_of(whole, fit)  # type: ignore[arg-type]
        assert covariance is not None
        np.testing.assert_allclose(covariance.sigma, found.std(axis=0), rtol=0.25, err_msg=weight)
        sigma[weight] = covariance.sigma_unit * np.sqrt(np.mean(c.spread**2))
    np.testing.assert_allclose(sigma["{x: 1.0, y: 2500.0}"], sigma["{x: 100.0, y: 250000.0}"])
    assert np.all(sigma["value"] > sigma["sigma"])


def test_windows_and_masks_of_a_channel() -> None:
    whole = model(
        "{du: {window: {t: [[2, 8], [20, 31]], y: [-10, 15]}, mask: [{centre: [1, 3], radius: 2}]},"
        " dtheta: {window: {t: [[8, 30]]}, mask: [{x: [6, 10]}, {t: [15, 17]}, {polygon: [[-9, -16], [-7, -16], [-7, 16], [-9, 16]]}]}}"
    )
    du, dtheta = whole.comparisons
    assert set(TIME[du.rows[:, 0]]) == {2.0, 3.0, 4.0, 6.0, 8.0, 23.0, 30.0}
    at = XY[du.rows[:, 1]]
    assert at[:, 1].min() == -9.0 and at[:, 1].max() == 15.0 and not np.any(np.hypot(*(at - [1.0, 3.0]).T) < 2.0)
    assert len(np.unique(du.rows[:, 1])) == 5 * 5 - 1
    assert set(TIME[dtheta.rows[:, 0]]) == {8.0, 12.0, 23.0, 30.0}  # the reference before loading is kept
    assert set(XY[dtheta.rows[:, 1], 0]) == {-3.0, 1.0, 5.0}
    _, jacobian = whole.linearised(Parameters.of(TRUTH), ("E", "c0"))
    assert jacobian.shape == (du.n + dtheta.n, 2) and np.isfinite(jacobian).all()
    with pytest.raises(DataError, match="leave no observation"):
        model("{du: {window: {x: [100, 120]}}}")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("{du: {mask: [{centre: [0, 0]}]}}", "expected both for a disc"),
        ("{du: {mask: [{}]}}", "is empty"),
        ("{du: {mask: [{x: [0, 1], centre: [0, 0], radius: 1}]}}", "several shapes"),
        ("{du: {window: {x: [3, 1]}}}", "increasing"),
        ("{du: {weight: balance}}", "expected"),
        ("{du: {}}, du: {scheme: gradient, components: [xx, yx]}", "symmetric"),
    ],
)
def test_wrong_windows_are_one_sentence(text: str, match: str) -> None:
    with pytest.raises(StudyError, match=match) as error:
        study(f"stages:\n  plastic: {{free: [E], channels: {text}}}\n")
    assert "stages.plastic" in str(error.value)
