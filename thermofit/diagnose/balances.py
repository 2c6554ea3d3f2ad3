"""Local balances of every body test as independent witnesses, and what they say beside the whole model.

A residual that is there in the whole model and not in the local balance comes from outside the observed field. One that is in the local
balance is inside: a law, a source, an instrument that looks there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import AT
from thermofit.diagnose.significance import SignificanceMap, significance
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.unlisted import standing
from thermofit.experiment.joint import JointParts
from thermofit.experiment.local_balance import JointErrors, LocalBalance, has_sections, shown
from thermofit.experiment.piece_heat import piece_heat
from thermofit.experiment.residuals import Span, named_phases
from thermofit.experiment.section_force import measured_flow, section_force

Where = Literal["inside", "outside", "none"]
"""Where a residual comes from, seen from the observed field; none: there is none."""


@dataclass(frozen=True)
class Witness:
    """The map of one balance of one test (its name; empty: it is alone), whether the whole model leaves structure in that channel, and
    where it comes from."""

    test: str
    map: SignificanceMap
    whole: bool
    where: Where
    spans: tuple[Span, ...]


@dataclass(frozen=True)
class Witnesses:
    """All maps, and in words why there is none of a balance."""

    maps: tuple[Witness, ...]
    without: tuple[str, ...]

    @property
    def where(self) -> Where:
        """The word of all maps together: inside counts most."""
        said = [w.where for w in self.maps]
        return "inside" if "inside" in said else "outside" if "outside" in said else "none"


def witnesses(here: Traced, parts: JointParts | None) -> Witnesses | None:
    """Local balances of all body tests at the parameters of a trace; None where no body was tested. What fails is said, and counts as no
    map."""
    if parts is None:
        return None
    stands = {s.blocks.channel for s in standing(here, here.problem.numerical)}
    left = _by_channel(here)
    found, without = [], []
    for name, joint in parts.each.items():
        lead = f"{name}: " if name else ""
        if not has_sections(joint):
            without.append(f"{lead}local balances need a straight bar or a dogbone, not the shape {joint.study.geometry.shape}")
            continue
        own = [(c.partition(AT)[0], rows) for c, rows in left.items() if c.partition(AT)[2] == name]
        spans = named_phases(joint.data.phases)
        try:
            seen = shown(joint, parts.seen_by(here.case.parameters, name), own)
        except (NumericsError, StudyError) as error:
            without.append(f"{lead}local balances: the run failed ({error})")
            continue
        balances: dict[str, Callable[[], LocalBalance | None]] = {
            "force through sections": partial(section_force, seen, spans),
            "heat of pieces": partial(_heat, seen, spans),
        }
        for kind, make in balances.items():
            try:
                balance = make()
            except (NumericsError, StudyError) as error:
                without.append(f"{lead}{kind}: {error}")
                continue
            if balance is None:
                without.append(f"{lead}{kind}: not enough was measured, or it is not compared")
                continue
            try:
                made = significance(balance)
            except np.linalg.LinAlgError:
                without.append(f"{lead}{kind}: some cells have no noise of their own; check the noise of the data")
                continue
            channel = balance.channel + (f"{AT}{name}" if name else "")
            found.append(Witness(name, made, channel in stands, where_of(channel in stands, made.stands_out), spans))
    return Witnesses(tuple(found), tuple(without))


def _heat(seen: JointErrors, spans: tuple[Span, ...]) -> LocalBalance | None:
    """The balance of heat with the flow that was measured; with the predicted one where the law cannot follow the measured strain."""
    try:
        flow = measured_flow(seen, spans)
    except (NumericsError, StudyError):
        flow = None
    return piece_heat(seen, flow)


def where_of(whole: bool, local: bool) -> Where:
    """The word for a residual that stands out in the whole model or not, and in the local balance or not."""
    return "inside" if local else "outside" if whole else "none"


def _by_channel(here: Traced) -> dict[str, np.ndarray]:
    """Rows of the whitened error of mesh and steps that may be left by channel."""
    out: dict[str, np.ndarray] = {}
    at, error = 0, here.problem.may_be_left
    for c in here.case.model.comparisons:
        if error is not None:
            out[c.channel] = error[at : at + c.n]
        at += c.n
    return out
