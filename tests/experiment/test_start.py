"""A start that cannot carry the measured force is replaced by what the mean stress-stretch curve says."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from made_up import TRUTH, uniaxial_test

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import param
from thermofit.core.slots import Slots
from thermofit.experiment.start import carries, feasible_start
from thermofit.experiment.window import elastic_slope

PLASTIC = ("M_y0", "M_yinf", "H_exp", "F")


def study(**bounds: tuple[float, float]) -> Any:
    """What the start needs of a study."""
    return SimpleNamespace(
        hardening_law="model2",
        slots=Slots("model2"),
        material_axes=SimpleNamespace(angle=0.0),
        force=SimpleNamespace(drives="force"),
        bounds=lambda n: bounds.get(n, (param(n).lower, param(n).upper)),
        scale=lambda n: param(n).scale,
        geometry=SimpleNamespace(shape="dogbone"),
        source=Path("study.yaml"),
    )


def test_a_sheet_cut_across_reads_g_for_h() -> None:
    """Rolling direction across the load: the same curve, with H of the load direction under the name G."""
    across = study()
    across.material_axes.angle = 90.0
    sheet = TRUTH.replace(G=TRUTH["H"], H=2.0 * TRUTH["H"])
    weak = sheet.replace(M_yinf=200.0, H_exp=5.0, F=0.6).with_free(PLASTIC)
    assert carries(across, uniaxial_test(), sheet) and not carries(across, uniaxial_test(), weak)
    found, _ = feasible_start(across, uniaxial_test(), weak)
    for name in PLASTIC:
        assert found[name] == pytest.approx(TRUTH[name], rel=0.02), name
    assert (found["G"], found["H"]) == (sheet["G"], sheet["H"])


def test_a_good_start_is_kept() -> None:
    data = uniaxial_test()
    start = TRUTH.with_free(PLASTIC)
    assert carries(study(), data, start)
    assert feasible_start(study(), data, start) == (start, "")


def test_a_weak_start_is_replaced_by_the_curve() -> None:
    data = uniaxial_test()
    weak = TRUTH.replace(M_yinf=200.0, H_exp=5.0, F=0.6).with_free(PLASTIC)
    assert not carries(study(), data, weak)
    found, remark = feasible_start(study(), data, weak)
    assert "too weak" in remark and "mean stress-stretch curve" in remark
    for name in PLASTIC:
        assert found[name] == pytest.approx(TRUTH[name], rel=0.02), name


def test_only_free_parameters_are_touched_and_bounds_hold() -> None:
    data = uniaxial_test()
    weak = TRUTH.replace(M_yinf=150.0).with_free(("M_yinf",))
    found, _ = feasible_start(study(), data, weak)
    assert {n for n in found.values if found[n] != weak[n]} == {"M_yinf"}
    with pytest.raises(NumericsError, match=r"raise parameters\.M_yinf"):
        feasible_start(study(M_yinf=(140.0, 200.0)), data, weak)


@pytest.mark.parametrize(
    ("bounds", "refused"),
    [((0.5, 2.0), False), ((0.9, 1.1), False), ((0.2, 0.85), False), ((0.2, 0.7), True), ((1.4, 5.0), True), ((1.15, 5.0), False)],
)
def test_bounds_of_e_without_the_elastic_slope_are_refused(bounds: tuple[float, float], refused: bool) -> None:
    """E could only end at such a bound; up to a quarter beyond it the mean strain of a specimen is not that sure."""
    data, free = uniaxial_test(), TRUTH.with_free(("E", "nu"))
    slope = elastic_slope(data)
    assert slope is not None and slope[0] == pytest.approx(TRUTH["E"], rel=0.03)
    own = study(E=(bounds[0] * TRUTH["E"], bounds[1] * TRUTH["E"]))
    if not refused:
        assert feasible_start(own, data, free) == (free, "")
        return
    with pytest.raises(StudyError, match="E would end at its bound"):
        feasible_start(own, data, free)
    assert feasible_start(own, data, TRUTH.with_free(("nu",)))[1] == ""


def test_where_a_displacement_drives_a_start_far_off_the_curve_is_replaced() -> None:
    """Too strong or too weak; one that is two per cent off is as good as the curve, and what is not free stays."""
    data, driven = uniaxial_test(), study()
    driven.force.drives = "dic"
    for far in (TRUTH.replace(M_y0=1.3 * TRUTH["M_y0"], M_yinf=1.3 * TRUTH["M_yinf"]), TRUTH.replace(M_yinf=200.0, H_exp=5.0)):
        found, remark = feasible_start(driven, data, far.with_free(PLASTIC))
        assert "off the mean stress-stretch curve; used are M_y0 = " in remark
        for name in PLASTIC:
            assert found[name] == pytest.approx(TRUTH[name], rel=0.02), name
    near = TRUTH.replace(M_y0=1.01 * TRUTH["M_y0"], M_yinf=1.01 * TRUTH["M_yinf"]).with_free(PLASTIC)
    assert feasible_start(driven, data, near) == (near, "")
    held = TRUTH.replace(M_y0=1.3 * TRUTH["M_y0"], M_yinf=1.3 * TRUTH["M_yinf"]).with_free(("F",))
    assert feasible_start(driven, data, held) == (held, ""), "with the curve held, F comes no nearer to it"


def test_a_test_that_hardly_flows_keeps_its_start_where_a_displacement_drives() -> None:
    driven, short = study(), uniaxial_test(last=0.002)
    driven.force.drives = "crosshead"
    far = TRUTH.replace(M_yinf=200.0).with_free(PLASTIC)
    assert feasible_start(driven, short, far) == (far, "")
