"""A fit that leaves a channel far above its noise says so."""

from thermofit.identify.outcome import misfits


def test_misfit_is_remarked_on_and_a_good_fit_is_not() -> None:
    channels = {"u": {"chi2_reduced": 362.0}, "du": {"chi2_reduced": 1.08}}
    (remark,) = misfits(channels)
    assert remark.startswith("u is left at 19 times its noise")
