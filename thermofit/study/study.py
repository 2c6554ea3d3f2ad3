"""The study file: read, checked and completed. Everything a user gets wrong becomes one sentence (StudyError)."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from thermofit.core.digest import use_effect_files
from thermofit.core.errors import StudyError
from thermofit.core.experiment import MeasuredTest, Specimen
from thermofit.core.files import TEXT_LIMIT, check_regular
from thermofit.core.parameters import AT, Parameters, param
from thermofit.core.yaml_text import parse_yaml
from thermofit.law.hardening.catalogue import hardening, hardening_laws
from thermofit.law.surface.catalogue import surface, surfaces
from thermofit.study.coupon import Coupon, CouponRecordSettings
from thermofit.study.errors import near_miss, sentence
from thermofit.study.models import OwnExperiment, Sections, StudyFile, bounds_of, check_starts, is_prescribed, start_of, virtual_of
from thermofit.study.paths import first_uses, notice, path_from
from thermofit.study.raw_folder import has_displacements
from thermofit.study.reading import reading, seen
from thermofit.study.section import MeshSize, ParameterStart, mesh_size
from thermofit.study.series import with_series
from thermofit.study.stages import COUPON_CHOICES, Stages, StageSettings, coupon_stage

_FIELDS = (
    *("geometry", "specimen", "static", "evaluation", "force", "ir.edge_margin", "ir.blur", "noise"),
    *("numerics.steps_per_interval", "numerics.max_time_step", "numerics.force_tolerance"),
)
"""Keys by which the data of a full-field test are made ready."""
_MOTION = (
    *("model", "hardening", "yield_surface", "material_axes", "mesh", "parameters", "numerics", "diagnosis.free"),
    *("stages.elastic.free", "stages.plastic.free", "stages.thermal.free"),
)
"""Keys by which the motion of a test without displacements is computed, or refused."""
Check = Callable[[Sequence[Path]], None]
"""Raises StudyError where an effect file does not do what its slot asks."""


_SECTIONS = frozenset(Sections.model_fields)


class Study(Sections):
    """A loaded study: the sections of the file, defaults filled in, and its paths resolved."""

    source: Path
    """The study file, absolute."""
    experiment: Path
    """Raw folder, absolute; <run_dir>/raw for a virtual experiment and where there are only coupon records."""
    run_dir: Path
    """Folder of artefacts and figures, absolute."""
    virtual: bool
    """True where the raw folder is to be made by `simulate`."""
    overrides: tuple[str, ...] = ()
    """Keys that the command line has set, as key=value."""

    def __getattribute__(self, name: str) -> Any:
        """A section only where the record that is being made may read it."""
        value = super().__getattribute__(name)
        return seen(name, value) if name in _SECTIONS else value

    @property
    def mesh_size(self) -> MeshSize:
        """Numbers of elements of the mesh."""
        return mesh_size(self.mesh)

    @property
    def mesh_file(self) -> Path | None:
        """The mesh file of the section `geometry`, None where the shape is built in. StudyError for an unset variable."""
        if self.geometry.file is None:
            return None
        return path_from(self.source.parent, self.geometry.file, f"{self.source}: key 'geometry.file'")

    @property
    def necking_file(self) -> Path | None:
        """The file of the section `necking`, None where there is none. StudyError for an unset variable."""
        if self.necking is None:
            return None
        return path_from(self.source.parent, self.necking.file, f"{self.source}: key 'necking.file'")

    @property
    def records(self) -> tuple[CouponRecordSettings, ...]:
        """The records of coupons that were measured, held-out ones too; empty where the experiment is one of full fields."""
        return () if self.coupon is None else self.coupon.records

    @property
    def coupon_section(self) -> Coupon:
        """The section `coupon`. StudyError where there is none."""
        if self.coupon is None:
            raise StudyError(f"{self.source.name}: key 'coupon' is missing: name its records")
        return self.coupon

    @property
    def heated_by_measured_work(self) -> bool:
        """True where the measured stress on the measured strain heats the specimen, and not the law."""
        return self.coupon is not None and self.coupon.heat == "measured-work"

    @property
    def measured_in(self) -> tuple[str, ...]:
        """Keys of the study by which its measured data are made ready: of coupon records those of their section, and a prescribed E, which
        tells the elastic strain that is added to a flow curve, and what is no elastic line."""
        if self.coupon is None:
            return _FIELDS if self.has_displacements else (*_FIELDS, *_MOTION)
        return ("coupon", "parameters.E")

    @property
    def has_displacements(self) -> bool:
        """False where its raw folder declares infrared frames and no displacements."""
        return has_displacements(self.experiment)

    def stage(self, name: str) -> StageSettings:
        """Settings of a stage that is about to run; StudyError for an unknown name or a free parameter without a start."""
        if name not in Stages.model_fields:
            raise StudyError(f"{self.source.name}: stage '{name}' is not known{near_miss(name, Stages.model_fields)}")
        settings: StageSettings = getattr(self.stages, name)
        if self.coupon is not None:
            lateral = any("lateral" in record.model_fields_set for record in self.coupon.records)
            wanted = tuple(p for p in COUPON_CHOICES if not is_prescribed(self.parameters, p) and (p == "E" or p in self.parameters))
            freed = hardening(self.hardening_law).fitted
            wanted += tuple(p for p in freed if not is_prescribed(self.parameters, p))
            settings = coupon_stage(self.source.name, name, settings, self.coupon.control, hardening=freed, wanted=wanted, lateral=lateral)
        if missing := check_starts(settings, self.parameters):
            raise StudyError(f"{self.source.name}: key 'parameters.{missing}' is missing, but stage {name} identifies it: add its start")
        return settings

    def setting(self, name: str) -> float | ParameterStart | None:
        """What the study says of a parameter; of that of one experiment what that experiment says, else of the common one."""
        bare, _, experiment = name.partition(AT)
        own = self.experiments[experiment].parameters if experiment and experiment in self.experiments else {}
        return self.parameters.get(name, own.get(bare, self.parameters.get(bare)))

    def bounds(self, name: str) -> tuple[float, float]:
        """Lower and upper bound of a parameter: the study's, else the physical ones."""
        param(name)
        return bounds_of(name, self.setting(name))

    def scale(self, name: str) -> float:
        """Usual size of a parameter: the study's, else that of the law."""
        setting = self.setting(name)
        return setting.scale if isinstance(setting, ParameterStart) and setting.scale is not None else param(name).scale

    def start_parameters(self, experiment: MeasuredTest | None) -> Parameters:
        """Start values; what the study leaves out is neutral, the temperatures of air and jaws are the experiment's (K).

        theta_ref is theta_clamp where absent: the specimen rests in the closed jaws before the test. StudyError where
        neither the study nor an experiment gives theta_air or theta_clamp.
        """
        values = {name: start_of(setting) for name, setting in self.parameters.items()}
        measured = {} if experiment is None else {"theta_air": experiment.theta_air, "theta_clamp": experiment.theta_clamp}
        return Parameters.of(_with_temperatures({**measured, **values}, f"{self.source.name}: key 'parameters"))

    def truth_parameters(self) -> Parameters:
        """Parameters of the virtual experiment; StudyError where the study has none."""
        if self.simulate is None:
            raise StudyError(f"{self.source.name}: key 'simulate' is missing: add it to make a virtual experiment, see `thermofit new`")
        return Parameters.of(_with_temperatures(self.simulate.truth, f"{self.source.name}: key 'simulate.truth"))

    def truth_of(self, name: str) -> float | None:
        """The value of a parameter with which the virtual experiment was made, None where it is measured, and for a parameter of a
        hardening law or yield surface that the virtual material does not have."""
        bare, _, experiment = name.partition(AT)
        several = [self.one_of(other) for other in (experiment,) if other in self.experiments] or [self.one_of(n) for n in self.fitted]
        virtual = (several[0] if several else self).simulate
        if virtual is None:
            return None
        of_laws = {n for law in hardening_laws() for n in law.names}
        of_laws |= {n for one in surfaces() for n in one.names}
        own = (*hardening(virtual.hardening_law or self.hardening_law).names, *surface(virtual.yield_surface or self.yield_surface).names)
        return None if bare in of_laws and bare not in own else float(virtual.truth.get(bare, param(bare).neutral))

    @property
    def fitted(self) -> tuple[str, ...]:
        """Names of the experiments that are fitted jointly; empty where the study has one experiment only."""
        with reading(None):  # which tests there are is said by their artefacts
            return tuple(name for name, own in self.experiments.items() if not own.held_out)

    @property
    def held_out(self) -> tuple[str, ...]:
        """Names of the experiments that are predicted, not fitted."""
        with reading(None):
            return tuple(name for name, own in self.experiments.items() if own.held_out)

    @property
    def alone(self) -> Study:
        """The study of the one experiment that is fitted, without those held out."""
        return self.model_copy(update={"experiments": {}, "shared": ()})

    def one_of(self, name: str) -> Study:
        """The study of one of several experiments, with its own folder below the run folder."""
        own = self.experiments[name]
        with reading(None):
            return self._joined(name, own)

    def _joined(self, name: str, own: OwnExperiment) -> Study:
        """The study with what one experiment says itself."""
        stages = self.stages
        for key, window in own.windows.items():
            stages = stages.model_copy(update={key: getattr(stages, key).model_copy(update={"window": window})})
        simulate = virtual_of(self.simulate, own, list(self.experiments).index(name), f"experiments.{name}")
        folder = self.run_dir / name
        raw = folder / "raw"
        if own.experiment is not None:
            raw = path_from(self.source.parent, own.experiment, f"{self.source}: key 'experiments.{name}.experiment'")
        given = {k: v for k, v in self.parameters.items() if AT not in k}
        changes: dict[str, Any] = {
            "parameters": {**given, **own.parameters},
            "stages": stages,
            "simulate": simulate,
            "experiment": raw,
            "run_dir": folder,
            "virtual": simulate is not None,
        }
        if own.specimen is not None:
            changes["specimen"] = own.specimen
        return self.alone.model_copy(update=changes)

    def specimen_of(self, measured: Specimen) -> Specimen:
        """The measured specimen with the lengths (mm) that the study overrides."""
        return dataclasses.replace(measured, **self.specimen.model_dump(exclude_none=True))

    def config_of(self, *keys: str) -> dict[str, Any]:
        """The named sections ('mesh', 'stages.elastic') with defaults filled in, ready for JSON: a stage's provenance."""
        dump = self.model_dump(mode="json")
        config: dict[str, Any] = {}
        for key in keys:
            value: Any = dump
            for part in key.split("."):
                if not isinstance(value, dict) or part not in value:
                    raise KeyError(f"the study has no section '{key}'")
                value = value[part]
            config[key] = value
        return config


def load_study(path: str | Path, overrides: Sequence[str] = (), check_effects: Check | None = None) -> Study:
    """Read a study file and apply overrides such as `mesh=coarse` or `stages.thermal.method=nelder-mead`.

    `check_effects` is asked about effect files of the user's own, before anything is made of them.

    Raises StudyError with one sentence for anything that is wrong in the file, in an override or in the environment.
    """
    source = Path(path)
    tree = _read_tree(source)
    for override in overrides:
        set_key(tree, override)
    declare_effects(tree, source, check_effects)
    try:
        # The way through JSON makes copies of YAML aliases and refuses what JSON does not know (sets, bytes, cycles).
        file = StudyFile.model_validate(json.loads(json.dumps(tree)))
    except ValidationError as error:
        raise StudyError(_say(source, error, overrides)) from None
    except (TypeError, ValueError, RecursionError) as error:
        raise StudyError(f"{source}: expected texts, numbers, lists and sections only, but found something else ({error})") from None
    run_dir = path_from(Path.cwd(), file.run_dir or f"runs/{file.name}", f"{source}: key 'run_dir'")
    if not any(text.partition("=")[0].strip() == "run_dir" for text in overrides):
        _refuse_elsewhere(run_dir, source)
    if file.experiment is None:
        raw = run_dir / "raw"
    else:
        raw = path_from(source.parent, file.experiment, f"{source}: key 'experiment'")
    sections = {name: getattr(file, name) for name in Sections.model_fields}
    if file.coupon is not None:
        sections["coupon"] = with_series(file.coupon, source.parent, str(source))
    return Study(
        **sections, source=source.absolute(), experiment=raw, run_dir=run_dir, virtual=_is_virtual(file), overrides=tuple(overrides)
    )


def _refuse_elsewhere(run_dir: Path, source: Path) -> None:
    """StudyError where a study, which may be someone else's, would write into a folder of other things that whoever runs it has not named.

    Below the current folder and that of the study, in a new or empty folder, and in one that holds results already, a study may write.
    """
    homes, place = (Path.cwd().resolve(), source.absolute().parent.resolve()), run_dir.resolve()
    if any(place.is_relative_to(home) for home in homes) or not place.is_dir():
        return
    try:
        held = [path.name for path in place.iterdir()]
    except OSError as error:
        raise StudyError(f"{source}: key 'run_dir' is {run_dir}, which cannot be read ({error})") from None
    if held and not any(name == "raw" or name.endswith(".h5") for name in held):
        raise StudyError(
            f"{source}: key 'run_dir' is {run_dir}, a folder of other things ({len(held)}, among them {min(held)}) that lies neither below "
            f"the current folder nor below that of the study; expected a new folder or one of results: say it on the command line, "
            f"--run-dir {run_dir}, where it is meant"
        )


def _is_virtual(file: StudyFile) -> bool:
    """True where a raw folder, of any experiment, is made by `simulate`."""
    fitted = [own for own in file.experiments.values() if not own.held_out]
    return file.simulate is not None and (any(own.experiment is None for own in fitted) if fitted else file.experiment is None)


def json_schema() -> dict[str, Any]:
    """JSON schema of the study file, for editors (docs/study.schema.json)."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **StudyFile.model_json_schema()}
    schema["title"] = "thermofit study"
    return schema


def _with_temperatures(values: Mapping[str, float], key: str) -> dict[str, float]:
    """Values with theta_ref = theta_clamp where absent; StudyError where a temperature of the surroundings is absent."""
    for name in ("theta_air", "theta_clamp"):
        if name not in values:
            raise StudyError(f"{key}.{name}' is missing and no experiment gives it: add it in K")
    return {"theta_ref": values["theta_clamp"], **values}


def _say(source: Path, error: ValidationError, overrides: Sequence[str]) -> str:
    """The sentence for the first error, with the override that caused it, and the number of further ones."""
    # A list whose entries were refused is also reported as too short: the entry is what the user wants to read about.
    errors = error.errors(include_url=False)
    details = [e for e in errors if not (e["type"] == "too_short" and e["input"])] or errors
    key, text = sentence(details[0])
    guilty = [o for o in overrides if key == o.partition("=")[0] or key.startswith(o.partition("=")[0] + ".")]
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    cause = " with " + " ".join(guilty[-1].split()) if guilty else ""
    return f"{source}{cause}: {text}{more}"


def _read_tree(source: Path) -> dict[str, Any]:
    """The study file as nested dictionaries."""
    try:
        check_regular(source, TEXT_LIMIT)
        text = source.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise StudyError(f"{source}: expected a YAML text in UTF-8, found other bytes") from None
    except OSError as error:
        reason = error.strerror or "cannot be read"
        raise StudyError(f"{source}: {reason.lower()}; expected a study file, `thermofit new {source}` writes a commented one") from None
    tree = parse_yaml(text, str(source), StudyError)
    if not isinstance(tree, dict):
        what = "nothing" if tree is None else f"a {type(tree).__name__}"
        raise StudyError(f"{source}: expected a study (keys such as 'name:' and 'experiment:'), found {what}; compare `thermofit new`")
    return tree


def set_key(tree: dict[str, Any], override: str) -> None:
    """Set one dotted key of the tree of a study file to a YAML value. StudyError where that is not understood."""
    key, equals, text = override.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise StudyError(f"override '{override}' is not understood: expected key=value, for example mesh=coarse")
    place = tree
    for depth, part in enumerate(parts[:-1], start=1):
        if place.get(part) is None:
            place[part] = {}
        inner = place[part]
        if not isinstance(inner, dict):
            raise StudyError(f"override '{override}': key '{'.'.join(parts[:depth])}' is {inner!r} in the study, not a section of keys")
        # A copy: sections that share a YAML anchor are one object, and only the named one is meant.
        place[part] = dict(inner)
        place = place[part]
    place[parts[-1]] = parse_yaml(text, f"override '{override}'", StudyError)


def declare_effects(tree: dict[str, Any], source: Path, check: Check | None = None) -> None:
    """Make the effects known that a study tree speaks of, and `check` those of the user; a study without any costs nothing.

    Before a file of the user is used for the first time stderr says so.

    Files of a user are compiled into the kernels: they are named before these are loaded. StudyError for a file that is not there, and
    where kernels without it are loaded already.
    """
    files = _files(tree, source)
    if files and not use_effect_files(files):
        raise StudyError(f"{source}: key 'effects': the kernels are loaded already without these files; start a new process for it")
    for file in first_uses(files):
        sys.stderr.write(notice(source, file) + "\n")
    if files or "." in "".join(_names(tree)):
        import thermofit.effects.catalogue  # noqa: F401  (it declares the Params of all effects, and loads numba)
    if files and check is not None:
        check(files)


def _files(tree: dict[str, Any], source: Path) -> list[Path]:
    value = tree.get("effects") or []
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise StudyError(f"{source}: key 'effects' is {value!r}; expected a list of effect files, [my_effect.py]")
    paths = []
    for name in value:
        path = path_from(source.parent, name, f"{source}: key 'effects'").resolve()
        if not path.is_file():
            raise StudyError(f"{source}: key 'effects': no file {path} found; put it there or correct the path")
        paths.append(path)
    return paths


def _names(tree: dict[str, Any]) -> list[str]:
    """Names of parameters that the tree mentions."""
    parameters, out = tree.get("parameters"), []
    if isinstance(parameters, dict):
        out += [str(name) for name in parameters]
    for key in ("stages", "diagnosis", "gridsearch", "sensitivity", "simulate", "experiments", "shared", "compare", "literature"):
        out += _texts(tree.get(key))
    return [name for name in out if "/" not in name and not name.replace(".", "").isdigit()]


def _texts(value: Any) -> list[str]:
    if isinstance(value, dict):
        return [str(k) for k in value] + [t for v in value.values() for t in _texts(v)]
    if isinstance(value, list):
        return [t for v in value for t in _texts(v)]
    return [value] if isinstance(value, str) else []
