"""Coupon records: the native files that a study names, mapped onto nominal strain and stress, tension positive."""

from __future__ import annotations

from pathlib import Path

from thermofit.core.experiment import CouponRecord
from thermofit.core.study_coupon import Coupon, CouponRecordSettings


def coupon_files(settings: Coupon, base_folder: Path) -> tuple[Path, ...]:
    """All files that the section names, each once, in its order; StudyError for a variable that is not set."""
    raise NotImplementedError


def read_coupon(settings: Coupon, base_folder: Path) -> tuple[CouponRecord, ...]:
    """All records of the section, in its order; `base_folder` is that of the study file.

    StudyError for a column, a test or a length that the study must give; DataError for a file or values that are wrong.
    """
    return tuple(read_coupon_record(record, base_folder) for record in settings.records)


def read_coupon_record(settings: CouponRecordSettings, base_folder: Path) -> CouponRecord:
    """One record; errors as `read_coupon`."""
    raise NotImplementedError
