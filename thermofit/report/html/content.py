"""What a report says, without how it looks: the JSON twin `report.json`. Its schema is docs/report.schema.json."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

FORMAT = 1
"""Version of report.json; keys may be added, not renamed."""
Asked = Literal["loop", "diagnosis", "verification", "identification", "nothing"]
State = Literal["added", "refused", "not tried", "beyond its bounds"]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Level(_Part):
    """An error of one channel in units of its noise before and after effects were added, with standard errors; null: not known."""

    before: float | None = None
    before_sigma: float | None = None
    after: float | None = None
    after_sigma: float | None = None


class Bars(_Part):
    """One channel: error of the fit, error on unseen data, floor of mesh and steps, scatter between specimens; all over the noise."""

    channel: str
    words: str
    unit: str
    noise: float
    fit: Level
    held_out: Level
    floor: float | None
    scatter: float | None


class Rung(_Part):
    """One candidate cause: by how much the error on unseen data falls with it (share of the mean square), its estimate, and why it was not
    added."""

    effects: list[str]
    family: list[str]
    formula: str
    gain: float | None
    gain_sigma: float | None
    z: float | None
    estimate: str
    state: State
    why: str


class Smallest(_Part):
    """The smallest amplitude of an effect that this test would have shown."""

    effect: str
    parameter: str
    amplitude: float
    unit: str
    share_of_its_own: float | None
    """What no fitted parameter imitates, from 0 to 1."""


class Value(_Part):
    """A parameter with its standard error and its 95 % interval from the noise alone."""

    name: str
    unit: str
    value: float
    sigma: float | None
    low: float | None
    high: float | None
    start: float | None
    lower: float | None
    upper: float | None
    at_bound: bool
    of_effect: bool
    before: float | None
    """Value before effects were added."""
    true: float | None
    stage: str


class PhaseRow(_Part):
    """Residual of a channel in a phase over the noise: of the verified model, of the last one of the loop; floor of mesh and steps."""

    channel: str
    phase: str
    t0_s: float
    t1_s: float
    n: int
    verified: float | None
    last: float | None
    floor: float | None


class Correlation(_Part):
    """Correlation of the parameters of one stage."""

    stage: str
    names: list[str]
    matrix: list[list[float | None]]


class Profile(_Part):
    """Rise of the objective over its minimum, in squared standard errors, over one parameter."""

    name: str
    unit: str
    value: list[float]
    rise: list[float | None]


class StageState(_Part):
    """One stage of the run: done, doubtful, stale, unreadable or missing, with its verdict and provenance."""

    stage: str
    state: Literal["done", "doubtful", "stale", "unreadable", "missing"]
    says: str
    command: str
    created: str
    version: str
    source: str
    wall_s: float | None
    packages: dict[str, str]
    inputs: dict[str, str]


class Verdict(_Part):
    """The answer in one sentence, what speaks against it, and what is open."""

    sentence: str
    asked: Asked
    trustworthy: bool
    open: list[str]
    next_step: str


class Remark(_Part):
    """What a stage remarks, or notes."""

    stage: str
    text: str


class Report(_Part):
    """A whole report."""

    format: int
    name: str
    made_with: str
    verdict: Verdict
    bars: list[Bars]
    ladder: list[Rung]
    smallest: list[Smallest]
    not_shown: list[str]
    decide: list[str]
    unlisted: dict[str, Any] | None
    local_balances: dict[str, Any] | None = None
    """What local balances say, as in the result of `diagnose` or `close-loop`; null: they were not asked."""
    drift: dict[str, Any] | None = None
    """Which fitted parameters want to change with what, as in that result."""
    facts: list[tuple[str, str]]
    parameters: list[Value]
    phases: list[PhaseRow]
    correlations: list[Correlation]
    profiles: list[Profile]
    stages: list[StageState]
    missing: list[str]
    remarks: list[Remark]


def report_schema() -> dict[str, Any]:
    """JSON schema of report.json."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Report.model_json_schema()}
