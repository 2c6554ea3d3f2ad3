"""Coupon tests that are only planned: the response of the assumed material to a programme, with the noise of the study's own records.

Of the records only what a laboratory knows beforehand is used: noise, largest strain, duration, temperatures, whether there is a sensor.
The measured response is not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.experiment.coupon_model import coupon_run, point_settings
from thermofit.experiment.coupon_records import CouponData, CouponTest, coupon_data, read_tests, whole
from thermofit.experiment.fields import INTERPOLATE
from thermofit.experiment.programmes import OWN
from thermofit.point.driver import PointHistory, simulate
from thermofit.point.programmes import Usual, programme
from thermofit.records.staging import artefact_path
from thermofit.study.study import Study


def records_of(study: Study) -> CouponData:
    """The records of a study, from `interpolate` where it has run, else from their files. DataError where these cannot be read."""
    if artefact_path(study.run_dir, INTERPOLATE).exists():
        return coupon_data(study)
    return CouponData(tuple(test for test, _ in read_tests(study)), study.coupon_section.control)


def planned_records(study: Study, records: CouponData, name: str, assumed: Parameters) -> CouponData:
    """The records as the assumed material would give them: under their own programmes, or one test under the programme of that name.

    StudyError for an unknown name; NumericsError where the coupon cannot be driven so.
    """
    run = coupon_run(study, records, assumed.free)
    if name == OWN:
        return replace(records, tests=tuple(_answered(test, run.history(assumed, test)) for test in records.tests))
    first = records.tests[0]
    parameters = run.parameters_of(assumed, first)
    driven = programme(name, _usual(records), parameters, point_settings(study))
    history = simulate(parameters, driven, point_settings(study))
    start = first.theta_start if driven.theta_start is None else driven.theta_start
    test = replace(first, name=name, time=history.time, theta_start=start, phases=whole(history.time))
    return replace(records, tests=(_answered(test, history),))


def _usual(records: CouponData) -> Usual:
    """Largest strain over all records, and their median rate towards it."""
    peaks = np.array([float(np.max(np.abs(test.strain))) for test in records.tests])
    paths = np.array([float(np.sum(np.abs(np.diff(test.strain)))) / float(np.ptp(test.time)) for test in records.tests])
    return Usual(float(peaks.max()), float(np.median(paths)), records.tests[0].theta_start)


def _answered(test: CouponTest, history: PointHistory) -> CouponTest:
    """The record with the response of a history instead of its own."""
    theta = None if test.theta is None else history.theta_sensor
    lateral = None if test.lateral is None else history.lateral_x
    return replace(test, strain=history.strain, stress=history.stress, theta=theta, lateral=lateral)
