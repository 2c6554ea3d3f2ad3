"""Does a result agree with the thesis? The answer is computed, and the reason is chosen by it: none is written before the result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from thesis_read import free_names, percent, value

from thermofit.records.artefact import Record


@dataclass(frozen=True)
class Why:
    """What is said behind a comparison: one text where it agrees, another where it differs."""

    agrees: str = ""
    differs: str = ""


NOTHING = Why()


@dataclass(frozen=True)
class Compared:
    """One comparison of a result with the thesis: what is compared, whether both agree, both figures, why, and the word for agreement."""

    what: str
    agrees: bool
    here: str
    thesis: str
    why: Why = NOTHING
    word: str = "Agrees"

    @property
    def line(self) -> str:
        """As an item of a list."""
        reason = self.why.agrees if self.agrees else self.why.differs
        word = self.word if self.agrees else "Differs"
        return f"- **{word}**: {self.what}: here {self.here}; thesis {self.thesis}." + (f" {reason}" if reason else "")


def listed(*found: Compared) -> str:
    """Comparisons as a list."""
    return "\n".join(one.line for one in found)


def signed(share: float) -> str:
    """A relative change in %."""
    return f"{100.0 * share:+.0f} %" if abs(share) >= 0.1 else f"{100.0 * share:+.2g} %"


SAME_SIGN = "Same sign"
"""What is said of relative changes that have one sign: whatever their sizes, which are no agreement."""


def same_sign(what: str, here: float, thesis: float, why: Why = NOTHING) -> Compared:
    """Relative changes that have one sign, or differ in it."""
    return Compared(what, here * thesis > 0.0, signed(here), signed(thesis), why, SAME_SIGN)


def same_size(what: str, here: float, thesis: float, why: Why = NOTHING, factor: float = 2.0) -> Compared:
    """Relative changes agree in size where one is at most `factor` times the other."""
    small, large = sorted((abs(here), abs(thesis)))
    return Compared(
        f"{what} (within a factor of {factor:g})", here * thesis > 0.0 and large <= factor * small, signed(here), signed(thesis), why
    )


def same_word(what: str, here: str, thesis: str, why: Why = NOTHING) -> Compared:
    """Words such as the verdict on uniqueness agree where they are equal."""
    return Compared(what, here == thesis, f"'{here}'", f"'{thesis}'", why)


def same_answer(what: str, here: tuple[bool, str], thesis: tuple[bool, str], why: Why = NOTHING) -> Compared:
    """Answers yes or no, each with its figure."""
    return Compared(what, here[0] == thesis[0], f"{_yes(here[0])} ({here[1]})", f"{_yes(thesis[0])} ({thesis[1]})", why)


def _yes(answer: bool) -> str:
    return "yes" if answer else "no"


def same_values(what: str, record: Record, printed: Mapping[str, float], within: float, why: Why = NOTHING) -> Compared:
    """All identified parameters that the thesis printed, within a relative difference; the worst one is named."""
    off = {name: value(record, name) / printed[name] - 1.0 for name in free_names(record) if printed.get(name)}
    worst = max(off, key=lambda name: abs(off[name]))
    here = f"largest difference {signed(off[worst])} ({worst})"
    return Compared(f"{what} (within {percent(within)})", abs(off[worst]) <= within, here, "the virtual material is its optimum", why)


def passes(verify: Record, channel: str = "dtheta") -> tuple[bool, str]:
    """Whether `verify` finds a channel explained by its noise, and its misfit over the noise."""
    row = verify.summary["channels"][channel]
    failed = channel in str(verify.summary["verdict"]).partition("not verified:")[2]
    return not failed, f"{channel} {float(row['rms']) / float(row['floor_rms']):.2f} times its noise"


def noise_or_not(record: Record, truth: Mapping[str, float]) -> Why:
    """Whether the intervals hold the deviations from the virtual material, by the largest in combined standard errors."""
    size, name = in_errors(record, truth)
    text = (
        f"The largest deviation in combined standard errors is {size:.1f} ({name}): the intervals hold it."
        if size < 3.0
        else f"{name} is off by {size:.0f} combined standard errors: the intervals do not hold it. The virtual material was computed on "
        "another mesh and with other time steps than it is identified with."
    )
    return Why(text, text)


def in_errors(record: Record, truth: Mapping[str, float]) -> tuple[float, str]:
    """The largest deviation from the truth in standard errors, and whose it is; 0 where none is known."""
    sizes = {}
    for name in free_names(record):
        sigma = record.parameters[name].sigma
        if sigma and name in truth:
            sizes[name] = abs(record.parameters[name].value - truth[name]) / sigma
    if not sizes:
        return 0.0, "-"
    worst = max(sizes, key=lambda name: sizes[name])
    return sizes[worst], worst


def same_place(
    what: str, here: tuple[Sequence[float], Sequence[float]], thesis: tuple[Sequence[float], Sequence[float]], why: Why
) -> Compared:
    """Where a curve of f (values, f) over a prescribed temperature is lowest, K: equal within half a step of the coarser one."""
    lowest = [values[min(range(len(f)), key=lambda i: f[i])] for values, f in (here, thesis)]
    step = max(max(abs(a - b) for a, b in zip(sorted(v), sorted(v)[1:], strict=False)) for v in (here[0], thesis[0]))
    return Compared(what, abs(lowest[0] - lowest[1]) <= 0.5 * step, f"{lowest[0]:.2f} K", f"{lowest[1]:.2f} K", why)
