"""Typed errors: each carries the exit code of the command line and one sentence for the user.

The sentence names file, line or key, what was found, what was expected and what to do.
"""


class ThermofitError(Exception):
    """An error that is meant for the user; the command line prints its text and never a traceback."""

    exit_code = 1


class StudyError(ThermofitError):
    """The command or the study file is wrong (exit 2)."""

    exit_code = 2


class DataError(ThermofitError):
    """The measured data are wrong (exit 3)."""

    exit_code = 3


class NumericsError(ThermofitError):
    """The numerics failed: no convergence after step cutting, a singular system (exit 4)."""

    exit_code = 4


class UntrustworthyError(ThermofitError):
    """Done, but the answer is not trustworthy: not identifiable, at a bound, not verified (exit 5)."""

    exit_code = 5
