"""The ranking of effects on a terminal."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.console import Console

from thermofit.cli.printing import show_loop, unlisted_lines
from thermofit.report.html.gather import unlisted_words
from thermofit.report.unlisted import in_words


@pytest.mark.parametrize(
    ("gain", "said"),
    [(0.1234, "12.34 +- 0.20"), (-0.5, "-50.00 +- 0.20"), (-1.5, "worse"), (None, "-")],
    ids=["gain", "loss", "more than doubled", "not judged"],
)
def test_gain_on_held_out_data_in_words_that_can_be_read(gain: float | None, said: str) -> None:
    """An effect that the held-out data refuse may make their error a thousand times as large: a per cent figure says nothing then."""
    row = {
        "effect": "lamp",
        "family": ["lamp"],
        "z": 5.0,
        "predicted_drop": 25.0,
        "estimate": {},
        "held_out_gain": gain,
        "held_out_sigma": 0.002,
    }
    out = StringIO()
    show_loop(Console(file=out, width=140), {"ranking": [{**row, "detectable": 0.01, "accepted": False, "remark": ""}]})
    assert f" {said} " in next(line for line in out.getvalue().splitlines() if "lamp" in line)


def test_errors_with_their_standard_errors_beside_both_floors() -> None:
    """Of a held-out test there is no fit and no error of the mesh; the table stays within the page."""
    fit, held = {"dtheta": 0.02905}, {"dtheta": 0.02911, "dtheta@second": 0.03}
    floors = {"floor": {"dtheta": 0.025, "dtheta@second": 0.025}, "numerical": {"dtheta": 0.0012345}}
    error = {"fit": fit, "fit_sigma": {"dtheta": 0.0003}, "held_out": held, "held_out_sigma": {"dtheta": 0.00031, "dtheta@second": None}}
    out = StringIO()
    show_loop(Console(file=out, width=140), {"ranking": [], "before": {**error, **floors}, "after": {**error, **floors}})
    lines = out.getvalue().splitlines()
    own, other = (next(line for line in lines if f" {name} " in line) for name in ("dtheta", "dtheta@second"))
    assert own.count(" 0.02905 +- 0.0003 ") == 2 and own.count(" 0.02911 +- 0.0003 ") == 2 and " 0.0012 " in own
    assert other.count(" 0.03 ") == 2 and other.count(" - ") == 3


def test_the_ranking_shows_the_predicted_drop_of_chi_square_within_the_page() -> None:
    """Long names, an estimate of two Params and a remark of the longest kind; no word of effect or estimate is cut."""
    estimate = {f"clamp_difference.{name}": {"value": -0.0123456, "sigma": 0.0012345, "unit": "K"} for name in ("difference", "other")}
    row = {"effect": "clamp_difference", "family": ["clamp_difference", "initial_gradient"], "z": 103.26, "predicted_drop": 123456.0}
    more = {"estimate": estimate, "held_out_gain": 0.1, "held_out_sigma": 0.01, "detectable": 0.0123456, "accepted": False}
    remark = "not significant, and a remark that is long enough to need two lines"
    out = StringIO()
    show_loop(Console(file=out, width=140), {"ranking": [{**row, **more, "remark": remark}]})
    lines = out.getvalue().splitlines()
    assert "chi2 drop" in lines[2] and all(len(line) <= 140 for line in lines)
    first = next(line for line in lines if "103.26" in line)
    assert all(f" {word} " in first for word in ("clamp_difference", "initial_gradient", "1.23e+05", "10.00 +- 1.00", "0.0123"))
    assert all(part in out.getvalue() for part in ("difference -0.01235", "0.0012 K"))


def test_effects_that_were_not_asked_are_named_in_one_line() -> None:
    out = StringIO()
    show_loop(Console(file=out, width=140), {"ranking": [], "not_asked": ["lamp", "radiation"]})
    assert "not asked  lamp, radiation: this driver, its channels or its records do not tell them\n" in out.getvalue()


def test_something_unlisted_without_a_place_says_over_which_state_and_beside_what() -> None:
    """A misfit that no term takes, and the same as a law over the state; on a terminal and in the verdict."""
    said = {"channel": "stress", "where": None, "best_listed": None, "resembles": [], "beside": ["rate_power"], "excess_share": 0.44}
    law = {"variable": "accumulated plastic strain", "largest_MPa": 12.34}
    for over_state in (None, law):
        out = StringIO()
        unlisted_lines(Console(file=out, width=140), {**said, "over_state": over_state})
        shown, words = out.getvalue(), in_words({**said, "over_state": over_state})
        assert "44 % of the misfit of stress beside rate_power is systematic" in words and "beside    rate_power" in shown
        for text in (shown, words):
            assert ("a yield stress over accumulated plastic strain, up to 12.3" in text) is (over_state is not None)
    for share, shown in ((0.004, "0.4 %"), (1.0, "100 %")):
        assert in_words({**said, "over_state": None, "excess_share": share}).startswith(f"{shown} of the misfit of stress")
        assert unlisted_words({**said, "excess_share": share}).startswith(f"{shown} of the misfit")


@pytest.mark.parametrize(
    ("explains", "resembles", "words"),
    [
        (0.78, ["dic_tilt"], "and dic_tilt, which would explain 78 % of it, only resembles it"),
        (0.5, [], "and dic_tilt, which would explain 50 % of it, was not accepted"),
        (0.49, ["dic_tilt"], "and no effect of the catalogue explains half of it"),
    ],
)
def test_what_is_unlisted_does_not_say_that_nothing_listed_explains_it_where_something_would(
    explains: float, resembles: list[str], words: str
) -> None:
    """In the verdict and in the report; a tilt that was taken back takes most of it."""
    best = {"effect": "dic_tilt", "explains": explains, "needed": 0.5}
    said = {"channel": "du", "where": None, "best_listed": best, "resembles": resembles, "beside": [], "excess_share": 0.2}
    said = {**said, "over_state": None}
    placed = {"kind": "displacement", "where": {"image": "all"}, "when_s": [0.0, 1.0], "amount": {"value": 1.0, "sigma": 0.1, "unit": "mm"}}
    for at in (said, {**said, **placed}):
        assert all(words.removeprefix("and ") in told for told in (in_words(at), unlisted_words(at)))


@pytest.mark.parametrize("failed", ["", "no run there"])
@pytest.mark.parametrize("offset", [0.0, 0.7])
def test_parameters_beside_an_unlisted_heat_stand_beside_those_of_the_joint_fit(failed: str, offset: float) -> None:
    spot = {"y_mm": -1.302, "spread_mm": None}
    rows = {} if failed else {"kappa": {"value": 131.23, "sigma": 4.2, "unit": "mW/(mm K)", "joint_fit": 98.76}}
    said = {
        **{"channel": "dtheta", "best_listed": None, "resembles": [], "beside": [], "kind": "heat source", "where": {"y_mm": 3.0}},
        **{"when_s": [1.0, 2.0], "phases": ["cooling"], "unit": "mW", "amount": {"value": 1.234, "sigma": 0.4}, "hints": []},
        **{
            "before": {"held_out": {}},
            "after": {"held_out": {}},
            "parameters": {
                "values": rows,
                "failed": failed,
                "spot": {**spot, "velocity_mm_per_s": 0.1234, "velocity_sigma": 0.0007, "at_s": 105.52} if offset else spot,
                "second": {"jaws": 0.02, "offset": offset},
                "held": {"rate_power.m": 0.25} if offset else {},
                "untold": ["what rate_power says counts as exact"] if offset else [],
            },
        },
    }
    out = StringIO()
    unlisted_lines(Console(file=out, width=140), said)
    shown = " ".join(out.getvalue().split())
    assert "1.234 +- 0.4" in shown
    assert (
        ("! no run there; those that act on temperatures have no standard errors" in shown)
        if failed
        else ("131.2 +- 4" in shown and "98.76" in shown)
    )
    second = "standard errors hold that there may be another history beside it: an offset of the infrared camera"
    assert (second in shown) == ("standard errors hold" in shown) == (offset > 0.0 and not failed) and "jaws" not in shown
    travels = "taken for one spot that travels at 0.123 +- 0.0007 mm/s, and is at y = -1.3 mm at 105.5 s"
    for words in (travels, "rate_power.m = 0.25: held beside it", "what rate_power says counts as exact"):
        assert (words in shown) == (offset > 0.0 and not failed)
