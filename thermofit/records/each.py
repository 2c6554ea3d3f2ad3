"""A stage on each of several experiments: every one leaves its record in a folder of its own, the study a record that lists them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from thermofit.records.staging import Made, Outcome, artefact_path, job, produce
from thermofit.study.study import Study

Run = Callable[..., Outcome]
"""`run(study, *, force) -> Outcome` of a stage."""


def each(study: Study, name: str, run: Run, applies: Callable[[Study], bool], *, force: bool = False) -> Outcome:
    """The stage on all experiments of a study, held-out ones too; the outcome is that of the fitted one, or the record of several.

    `applies` says of the study of one experiment whether the stage has anything to do there. Fresh where all of them are.
    """
    if not study.fitted:
        others = [run(study.one_of(held), force=force) for held in study.held_out if applies(study.one_of(held))]
        return run(study.alone, force=force) if applies(study.alone) or not others else others[-1]
    names = [n for n in (*study.fitted, *study.held_out) if applies(study.one_of(n))]
    outcomes = [run(study.one_of(n), force=force) for n in names]
    inputs = {f"{name}@{n}": artefact_path(study.run_dir / n, name) for n in names}
    task = job(study.run_dir, name, {"experiments": names}, inputs)
    return produce(task, lambda: _list(study, names, outcomes), force=force)


def _list(study: Study, names: Sequence[str], outcomes: Sequence[Outcome]) -> Made:
    rows: list[dict[str, Any]] = []
    pictures: list[str] = []
    told: dict[str, list[str]] = {"remarks": [], "notes": []}
    for name, outcome in zip(names, outcomes, strict=True):
        said = outcome.record.summary
        role = "held out" if name in study.held_out else "fitted"
        rows.append({"experiment": name, "role": role, "result": str(said.get("verdict", ""))})
        for kind, texts in told.items():
            texts += [f"{name}: {text}" for text in said.get(kind, ())]
        pictures += [str(said["picture"])] if said.get("picture") else []
    summary = {"verdict": f"{len(names)} experiments: {', '.join(names)}", "experiments": rows, **told, "figures": pictures}
    return Made({}, summary)
