"""`experiment.yaml` of a raw experiment folder: specimen, temperatures, where the records lie, landmarks of the infrared image."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BaseModel, BeforeValidator, Field, ValidationError, ValidationInfo, model_validator
from pydantic.fields import FieldInfo

from thermofit.core.errors import DataError
from thermofit.core.experiment import CELSIUS, Landmarks, Specimen
from thermofit.core.files import TEXT_LIMIT
from thermofit.core.units import known_unit
from thermofit.core.yaml_text import parse_yaml
from thermofit.read.formats.clock import Above0, Rules
from thermofit.read.ranges import Doubt
from thermofit.read.raw_text import read_lines, shorten
from thermofit.study.errors import content_error, sentence
from thermofit.study.models import PickedLandmarks
from thermofit.study.section import Count, Number, Section, Whole, expected

DESCRIPTION = "experiment.yaml"
_NATIVE = frozenset(Rules.model_fields) - {"unit"}
"""Keys that mean something beside `files` only, and may be notes beside `folder`."""


def _first_word(value: Any) -> Any:
    """The first word of a text; what follows explains it."""
    return value.split()[0].rstrip(",:;") if isinstance(value, str) and value.strip() else value


def _child(value: Any, info: ValidationInfo) -> Path:
    """Path of a file or folder inside the experiment's folder; that it is not there is said where it is read."""
    folder, path = Path((info.context or {})["folder"]), Path(_text(value))
    try:
        (folder / path).stat()
    except FileNotFoundError:
        pass
    except (OSError, ValueError):
        raise content_error(f"is {shorten(value)}; expected the name of a file or folder in {folder}") from None
    return folder / path


def _pattern(value: Any, info: ValidationInfo) -> Path:
    """Glob pattern of files inside the experiment's folder."""
    folder, pattern = Path((info.context or {})["folder"]), Path(_text(value))
    if pattern.is_absolute() or ".." in pattern.parts:
        raise content_error(f"is {shorten(value)}; expected files inside {folder}: put or link them there")
    return folder / pattern


def _text(value: Any) -> str:
    if not str(value).strip() or not isinstance(value, str | Path):
        raise content_error(f"is {shorten(value)}; expected a text")
    return str(value).strip()


_Child = Annotated[Path, BeforeValidator(_child), Field(validate_default=True)]
_Celsius = Annotated[Number, Field(gt=-CELSIUS), expected(f"a number above {-CELSIUS:g}")]
_Side = Annotated[Literal["front", "back"], BeforeValidator(_first_word), expected("front or back")]
_Seconds = Annotated[Literal["s"], BeforeValidator(_first_word), expected("s")]


class SpecimenKeys(Section):
    """Lengths in mm; the shape is checked where a mesh is made of it."""

    gauge_width_mm: Above0
    thickness_mm: Above0
    parallel_length_mm: Above0
    shoulder_radius_mm: Above0
    grip_width_mm: Above0
    total_length_mm: Above0
    gripped_length_each_end_mm: Above0

    def lengths(self) -> Specimen:
        """The same under the names that the rest of the program uses."""
        return Specimen(**{key.removesuffix("_mm").removesuffix("_each_end"): value for key, value in self.model_dump().items()})

    @model_validator(mode="after")
    def _fits(self) -> SpecimenKeys:
        pairs = (("gauge_width_mm", "grip_width_mm", 1), ("parallel_length_mm", "total_length_mm", 1))
        for small, large, factor in (*pairs, ("gripped_length_each_end_mm", "total_length_mm", 2)):
            if factor * getattr(self, small) > getattr(self, large):
                text = f"is {getattr(self, small):g} mm but {large} only {getattr(self, large):g} mm; correct one of them"
                raise content_error(text, key=small)
        return self


class Temperatures(Section):
    """Thermocouples read before the test."""

    theta_air_degC: _Celsius
    theta_clamp_degC: _Celsius


class Time(Section):
    """Unit of all times."""

    unit: _Seconds = "s"


class ForceFile(Section):
    """Where the force record lies."""

    file: _Child = Path("force.csv")


class FieldSource(Rules):
    """Where a full field lies: its folder, or native exports, which are read by the rules."""

    files: Annotated[Path, BeforeValidator(_pattern)] | None = None
    folder: _Child
    side: _Side

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if self.files is not None and "folder" in self.model_fields_set:
            raise content_error("is given besides 'folder'; keep one of them", key="files")
        return self


class Dic(FieldSource):
    """Displacements, and how many stages there should be."""

    folder: _Child = Path("dic")
    side: _Side = "front"
    stages: Count | None = None


class Ir(FieldSource):
    """Temperatures, how many frames there should be and of which size (rows, columns), and what was picked in one of them."""

    folder: _Child = Path("ir")
    frames: Count | None = None
    image_shape: Annotated[tuple[Count, Count], expected("[rows, columns]")] | None = None
    landmarks_frame: Annotated[Whole, Field(ge=0), expected("the number of a frame, counted from 0")] = 0
    landmarks: PickedLandmarks | None = None

    @model_validator(mode="after")
    def _celsius(self) -> Self:
        if self.files is None and _first_word(self.unit) != "degC":
            given = f"is {shorten(self.unit)}; expected degC" if self.unit else "is missing; add it, see the raw format"
            raise content_error(given, key="unit")
        return self


class _Keys(Section):
    """All sections of the file."""

    specimen: SpecimenKeys
    temperatures: Temperatures
    time: Time = Time()
    force: ForceFile
    dic: Dic | None = None
    ir: Ir | None = None
    confirmed: Annotated[tuple[Doubt, ...], expected(f"a list of some of {', '.join(get_args(Doubt))}")] = ()
    """Questions about the plausibility of the data whose answer is: they are right."""
    programme: Annotated[tuple[Annotated[str, BeforeValidator(str)], ...], expected("a list of texts, one for each phase")] = ()


class Description(_Keys):
    """Content of `experiment.yaml`: mm, s, degC. `dic` and `ir` are None where the file does not declare them."""

    folder: Path
    """Where the file lies."""

    @property
    def landmarks(self) -> Landmarks | None:
        """Landmarks of the infrared image, if declared."""
        return None if self.ir is None or self.ir.landmarks is None else self.ir.landmarks.of_frame(self.ir.landmarks_frame)


def _all_keys(model: type[BaseModel]) -> set[str]:
    inner = [_all_keys(section) for field in model.model_fields.values() if (section := _section(field))]
    return set(model.model_fields).union(*inner)


def _section(field: FieldInfo) -> type[BaseModel] | None:
    """The section that a key holds, None where it holds a value."""
    kinds = (field.annotation, *get_args(field.annotation))
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)


_KNOWN = _all_keys(_Keys)
"""All keys that are read: none of them is another one misspelt."""


def _without_notes(model: type[BaseModel], tree: dict[Any, Any], path: Path, above: str = "") -> dict[str, Any]:
    """The keys of a section that are read; others are notes for people, unless they look like one that is absent.

    DataError for a key that is needed and absent or empty, for one that is misspelt, and for a value in place of a section.
    """
    kept: dict[str, Any] = {}
    by_folder = issubclass(model, Rules) and tree.get("files") is None
    for key, field in model.model_fields.items():
        value, where = tree.get(key), f"{path}: key '{above}{key}'"
        if key == "note" or (by_folder and key in _NATIVE):
            continue
        if value is None and (field.is_required() or key not in tree):
            if key in tree:
                raise DataError(f"{where} is empty; give its value")
            _refuse_misspelt(tree, key, field.is_required(), f"{path}: key '{above}")
        elif value is not None and (section := _section(field)):
            if not isinstance(value, dict):
                raise DataError(f"{where} is {shorten(value)}; expected a section of keys")
            kept[key] = _without_notes(section, value, path, f"{above}{key}.")
        elif value is not None:
            kept[key] = value
    for key in ("mm_per_pixel", "origin_mm", "coordinates_of"):
        if by_folder and tree.get(key) is not None:
            where = f"{path}: key '{above}{key}'"
            raise DataError(f"{where} is for native exports; add 'files', such as files: exports/*.csv, or remove it")
    return kept


def _refuse_misspelt(tree: dict[Any, Any], key: str, needed: bool, where: str) -> None:
    """DataError for an absent key that is needed, and where a key of nearly its name stands in its place."""
    names = {str(name).lower(): str(name) for name in tree if name not in _KNOWN}
    close = difflib.get_close_matches(key.lower(), names, n=1, cutoff=0.6 if needed else 0.8)
    if not close and needed:
        raise DataError(f"{where}{key}' is missing; add it, see the raw format")
    for found in (names[name] for name in close):
        # A name that differs by its unit alone: the value is to be converted.
        (quantity, _, unit), (wanted, _, fixed) = found.rpartition("_"), key.rpartition("_")
        of_units = quantity == wanted and None not in (known_unit(unit), known_unit(fixed))
        other = f" convert the value from {unit} to {fixed}" if of_units else ""
        if not needed:
            raise DataError(f"{where}{found}' is not known; did you mean '{key}'?{other}")
        mend = f"{other} and name it '{key}'" if other else " correct the name, and convert the value where its unit is another one"
        raise DataError(f"{where}{key}' is missing; found '{found}' instead:{mend}")


def read_description(folder: Path) -> Description:
    """Read `experiment.yaml` of a raw folder; DataError for a missing folder, file or key, a wrong unit or type."""
    folder = Path(folder)
    if not folder.is_dir():
        raise DataError(f"{folder}: the folder of the experiment does not exist; correct the path")
    path = folder / DESCRIPTION
    tree = parse_yaml("\n".join(read_lines(path, "the description of the experiment", TEXT_LIMIT)), str(path), DataError, text_keys=False)
    if not isinstance(tree, dict):
        raise DataError(f"{path}: found {shorten(tree)}, expected keys such as 'specimen:' and 'temperatures:'; see the raw format")
    try:
        return Description.model_validate({**_without_notes(_Keys, tree, path), "folder": folder}, context={"folder": folder})
    except ValidationError as error:
        raise DataError(f"{path}: {sentence(error.errors(include_url=False)[0])[1]}") from None
