"""What may be read of a study while a record is made of it: the sections of its key, in this process and in workers."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import pytest

from thermofit.records.executor import Executor, Task, run_all
from thermofit.records.key import read_of
from thermofit.records.staging import Made, job, produce
from thermofit.study.reading import UndeclaredRead, reading
from thermofit.study.study import Study, load_study

TEXT = """
name: small
experiment: raw
mesh: coarse
parameters: {E: {start: 7.0e+4, bounds: [1.0e+4, 1.0e+5], scale: 1.0e+4}, nu: 0.3, theta_air: 297.0, theta_clamp: 296.0}
experiments: {other: {experiment: elsewhere, held_out: true, parameters: {theta_air: 299.0}}}
"""


@pytest.fixture
def study(tmp_path: Path) -> Study:
    path = tmp_path / "study.yaml"
    path.write_text(TEXT, encoding="utf-8")
    return load_study(path, [f"run_dir={tmp_path / 'run'}"])


def test_all_is_read_where_no_record_is_made(study: Study) -> None:
    assert study.mesh == "coarse" and study.noise.temperature is None and study.parameters["E"].bounds == (1e4, 1e5)


def test_a_section_that_the_key_lacks_cannot_be_read(study: Study) -> None:
    """Not by itself, not through a property or a copy, not by another way to the same section; what is in the key can."""
    with reading(read_of(study, "mesh", "hardening", "model")):
        assert (study.mesh_size.n_x, study.hardening_law, study.name, study.held_out) == (6, "model2", "small", ("other",))
        for read in (
            *(
                lambda: study.noise,
                lambda: study.parameters,
                lambda: study.model_copy(update={"mesh": "full"}).noise,
                lambda: study.mesh_file,
            ),
            *(lambda: study.one_of("other"), lambda: study.stage("elastic"), lambda: study.start_parameters(None)),
        ):
            with pytest.raises(UndeclaredRead, match="is read, but the key of the record lacks it"):
                read()
    assert study.noise.temperature is None


def test_of_a_section_only_the_keys_that_are_declared(study: Study) -> None:
    with reading(read_of(study, "stages.elastic", "stages.plastic.window", "numerics.max_time_step", "parameters.nu")):
        assert study.stages.elastic.free == ("E", "nu") and study.numerics.max_time_step == 5.0 and study.numerics.threads == 2
        assert study.stages.plastic.window == "all"
        assert study.parameters["nu"] == study.parameters.get("nu") == 0.3
        for read in (
            *(
                lambda: study.stages.plastic.free,
                lambda: study.stages.thermal,
                lambda: study.numerics.newton_tolerance,
                lambda: study.parameters["E"],
            ),
            *(lambda: study.parameters.get("E"), lambda: "E" in study.parameters, lambda: list(study.parameters)),
            *(lambda: study.parameters.items(), lambda: len(study.parameters), lambda: {**study.parameters}),
        ):
            with pytest.raises(UndeclaredRead):
                read()


def test_of_a_parameter_that_is_not_free_the_value_alone(study: Study) -> None:
    with reading(read_of(study, "parameters", "experiments", free=("nu",))):
        assert study.start_parameters(None)["E"] == 7e4 and study.one_of("other").parameters["theta_air"] == 299.0
        for read in (lambda: study.bounds("E"), lambda: study.scale("E")):
            with pytest.raises(UndeclaredRead, match=r"bounds|scale"):
                read()
    with reading(read_of(study, "parameters", "experiments", free=("E",))):
        assert (study.bounds("E"), study.scale("E")) == ((1e4, 1e5), 1e4)


def test_a_record_is_made_by_its_key(study: Study) -> None:
    """`produce` opens the sections of the key, and closes them again, also after an error."""
    task = job(study.run_dir, "stage", read_of(study, "mesh"), {})
    with pytest.raises(UndeclaredRead, match="'noise'"):
        produce(task, lambda: Made({}, {"found": str(study.noise)}))
    assert study.noise.temperature is None
    outcome = produce(task, lambda: Made({}, {"found": str(study.mesh)}))
    assert not outcome.fresh and produce(task, lambda: Made({}, {})).fresh


def noise_of(study: Study) -> Any:
    return study.noise.temperature


@pytest.mark.parametrize("where", [Executor(), Executor(2)], ids=["here", "processes"])
def test_workers_read_by_the_same_key(study: Study, where: Executor) -> None:
    tasks = [Task(f"part {k}", noise_of, (study,)) for k in range(2)]
    assert run_all(tasks, where) == [None, None]
    with reading(read_of(study, "noise")):
        assert run_all(tasks, where) == [None, None]
    with reading(read_of(study, "mesh")), pytest.raises(RuntimeError, match="'noise' of the study is read"):
        run_all(tasks, where)


def test_a_study_that_may_not_be_read_can_be_sent(study: Study) -> None:
    with reading(read_of(study, "mesh")):
        sent = pickle.loads(pickle.dumps(study))
    assert sent == study and sent.noise == study.noise
