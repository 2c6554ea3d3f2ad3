"""What the sections of the study file share: the base class, kinds of numbers, and named values of parameters."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Strict,
    Tag,
    TypeAdapter,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from thermofit.core.experiment import CELSIUS
from thermofit.core.parameters import NAMES, bare_name, is_known, known_names, param
from thermofit.law.hardening.catalogue import hardening, hardening_laws
from thermofit.law.surface.catalogue import surface, surfaces
from thermofit.study.errors import content_error, found, near_miss, unknown_key

Number = Annotated[float, Strict()]
"""A number: neither a text that looks like one nor true."""
Whole = Annotated[int, Strict()]
Positive = Annotated[Number, Field(gt=0)]
NonNegative = Annotated[Number, Field(ge=0)]
Count = Annotated[Whole, Field(ge=1)]


class Section(BaseModel):
    """A part of the study file: frozen; a key that it does not know is an error that names the near miss."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True, protected_namespaces=())

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, given: Any) -> Any:
        """An empty section means its defaults; the first unknown key is reported before anything else."""
        if given is None and not any(field.is_required() for field in cls.model_fields.values()):
            return {}
        if isinstance(given, dict):
            for key in given:
                if key not in cls.model_fields:
                    raise unknown_key(str(key), cls.model_fields)
        return given


def expected(what: str) -> WrapValidator:
    """A type whose errors all read: is ..., expected `what`."""

    def checked(value: Any, valid: ValidatorFunctionWrapHandler) -> Any:
        try:
            return valid(value)
        except ValidationError:
            raise content_error(f"is {found(value)}; expected {what}") from None

    return WrapValidator(checked)


def number_or(other: str) -> Discriminator:
    """Discriminator of `number | word | other`: the union member's name is no part of the user's key."""

    def form(value: Any) -> str:
        if isinstance(value, int | float) and not isinstance(value, bool):
            return "~number"
        return "~word" if isinstance(value, str) else other

    return Discriminator(form)


def word_or(other: str) -> Discriminator:
    """Discriminator of `word | other`."""
    return Discriminator(lambda value: "~word" if isinstance(value, str) else other)


def _mesh_form(value: Any) -> str:
    """Union member of a mesh: word, sheet or size."""
    if isinstance(value, str):
        return "~word"
    return "~sheet" if isinstance(value, GivenSheet) or (isinstance(value, Mapping) and "sheet" in value) else "~size"


def section_or_number(value: Any) -> str:
    """Union member of `number | section`: what is no number is taken for a section, whose error then says both."""
    return "~number" if isinstance(value, int | float) and not isinstance(value, bool) else "~section"


def _known_parameter(name: str) -> str:
    if not is_known(name):
        raise content_error(f"names no parameter: '{name}' is not known{near_miss(name, known_names())}")
    return name


_EFFECT_PARAM = r"^[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)?(@[A-Za-z0-9_-]+)?$"
ParameterName = Annotated[
    str, AfterValidator(_known_parameter), Field(json_schema_extra={"anyOf": [{"enum": list(NAMES)}, {"pattern": _EFFECT_PARAM}]})
]
"""A name of `core.parameters.LAW`, or <effect>.<param> of an effect; with @<experiment> that of one experiment alone."""


def physical_error(name: str, value: float) -> str | None:
    """What is wrong with the value of a parameter (outside its physical bounds, degC for K), None where nothing is."""
    law = param(name)
    if law.lower <= value <= law.upper:
        return None
    unit = "" if law.unit == "1" else f" {law.unit}"
    text = f"is {value:g}{unit}; expected {law.lower:g} to {law.upper:g}{unit} ({law.meaning})"
    if name.startswith("theta_") and -CELSIUS < value < 150.0:
        return f"{text}: temperatures are in K, was {value:g} degC = {value + CELSIUS:.2f} K meant?"
    if name == "beta" and value < 0.0:
        return f"{text}: with a negative beta plastic flow would absorb heat, against the second law (4.23), (4.24)"
    return text


def hardening_error(values: Mapping[str, float], law: str) -> tuple[str, str] | None:
    """Parameter and what is wrong with it where the hardening law of that name does not rise (M_yinf > M_y0 is needed, 4.28), else None."""
    own = hardening(law)
    return own.error({name: values.get(name, param(name).neutral) for name in own.names})


def check_values(values: dict[str, float]) -> dict[str, float]:
    """Named values inside the physical bounds, else the error that names the guilty one."""
    for name, value in values.items():
        if text := physical_error(name, value):
            raise content_error(text, key=name)
    return values


def _no_truth_value(value: Any) -> Any:
    """Python takes true for 1; the study must not."""
    if isinstance(value, bool):
        raise content_error(f"is {str(value).lower()}; expected 1 or 2")
    return value


ModelNumber = Annotated[Literal[1, 2], BeforeValidator(_no_truth_value)]
"""Model 1 (associated, 4.6) or 2 (non-associated, 4.7) of the thesis."""


def _known_law(name: str) -> str:
    known = [law.name for law in hardening_laws()]
    if name not in known:
        raise content_error(f"names no hardening law: '{name}' is not known{near_miss(name, known)}")
    return name


HardeningName = Annotated[str, AfterValidator(_known_law), Field(json_schema_extra={"pattern": "^[a-z][a-z0-9_]*$"})]
"""Name of a hardening law, a file of law/hardening."""


def _known_surface(name: str) -> str:
    known = [one.name for one in surfaces()]
    if name not in known:
        raise content_error(f"names no yield surface: '{name}' is not known{near_miss(name, known)}")
    return name


SurfaceName = Annotated[str, AfterValidator(_known_surface), Field(json_schema_extra={"enum": [one.name for one in surfaces()]})]
"""Name of a yield surface, a file of law/surface."""


def surface_error(names: Iterable[str], chosen: str) -> tuple[str, str] | None:
    """The first name that is a Param of another yield surface than the chosen one, and what is wrong; None where none is."""
    own = surface(chosen).names
    for name in names:
        bare = bare_name(name)
        others = [one.name for one in surfaces() if bare in one.names]
        if others and bare not in own:
            has = f"has {own[0]}{' and others' if len(own) > 1 else ''}" if own else "has no parameters"
            return name, f"is a parameter of yield surface {others[0]}, but yield_surface is {chosen}, which {has}; leave it out"
    return None


def law_named(model: int | None, name: str | None) -> str | None:
    """The hardening law that two keys `model` and `hardening` choose: the name, else that of the model; None where neither is given."""
    return name if name is not None or model is None else hardening(model).name


def check_law(model: int | None, name: str | None) -> None:
    """The error where `model` and `hardening` are both given and choose different laws."""
    if model is not None and name is not None and hardening(model).name != name:
        raise content_error(f"is {name}, but model {model} is {hardening(model).name}; give one of them", "hardening")


ParameterValues = Annotated[dict[ParameterName, Number], AfterValidator(check_values)]
"""Named values, each inside the physical bounds."""


class ParameterStart(Section):
    """Start value of a parameter, narrower bounds and the size of a step (`scale`)."""

    start: Number
    bounds: tuple[Number, Number] | None = None
    scale: Positive | None = None


ParameterSettings = Annotated[
    dict[
        ParameterName,
        Annotated[Annotated[Number, Tag("~number")] | Annotated[ParameterStart, Tag("~section")], Discriminator(section_or_number)],
    ],
    BeforeValidator(lambda value: {} if value is None else value),
]


def increasing(times: tuple[float, ...]) -> tuple[float, ...]:
    """Times in s, each later than the one before."""
    if any(b <= a for a, b in itertools.pairwise(times)):
        raise content_error("is not increasing; expected times in s, each later than the one before")
    return times


def no_repeats(names: tuple[str, ...]) -> tuple[str, ...]:
    """Names, each once."""
    if repeated := {name for name in names if names.count(name) > 1}:
        raise content_error(f"names {', '.join(sorted(repeated))} more than once; expected every parameter once")
    return names


Times = Annotated[tuple[Number, ...], Field(min_length=1), AfterValidator(increasing)]
Interval = Annotated[tuple[Number, Number], AfterValidator(increasing)]


LARGEST_MESH = 200_000
"""Nodes of a mesh that is asked for by numbers of elements; 24 x 160 x 8 elements have 36,225."""


class MeshSize(Section):
    """Elements of the quarter model: across half the width, along the length, across half the thickness."""

    n_x: Count
    n_y: Count
    n_z: Count

    @model_validator(mode="after")
    def _can_be_solved(self) -> Self:
        nodes = (self.n_x + 1) * (self.n_y + 1) * (self.n_z + 1)
        if nodes > LARGEST_MESH:
            raise content_error(f"asks for {nodes} nodes; expected at most {LARGEST_MESH}, `full` has 5265")
        return self

    @property
    def counts(self) -> Mapping[str, int]:
        """Numbers of elements along the axes along which the mesh is refined."""
        return {"n_x": self.n_x, "n_y": self.n_y, "n_z": self.n_z}

    @property
    def elements(self) -> int:
        """Number of elements."""
        return self.n_x * self.n_y * self.n_z

    @property
    def body(self) -> MeshSize:
        """The mesh of the body that it stands for: itself."""
        return self

    @property
    def coarse(self) -> MeshSize:
        """The preset whose optimum is a good start on a finer mesh."""
        return PRESETS["coarse"]

    @property
    def words(self) -> str:
        """As a sentence names it."""
        return f"{self.n_x} x {self.n_y} x {self.n_z}"

    def with_counts(self, counts: Mapping[str, int]) -> Self:
        """The mesh with other numbers of elements along the axes of `counts`."""
        return self.model_copy(update=dict(counts))


class SheetSize(MeshSize):
    """Elements of a sheet: across half the width, along the length; one layer over half the thickness (plane stress)."""

    n_z: Literal[1] = 1

    @property
    def counts(self) -> Mapping[str, int]:
        """A sheet is refined in its plane; what its one layer misses is told beside a body."""
        return {"n_x": self.n_x, "n_y": self.n_y}

    @property
    def body(self) -> MeshSize:
        """The body with as many elements in the plane, and so many layers as the presets have: `full` of 12 x 80, `coarse` of 6 x 40."""
        return MeshSize(n_x=self.n_x, n_y=self.n_y, n_z=max(2, round(self.n_x / 3)))

    @property
    def coarse(self) -> MeshSize:
        """A sheet with the elements of that preset in its plane."""
        coarse = PRESETS["coarse"]
        return SheetSize(n_x=coarse.n_x, n_y=coarse.n_y)

    @property
    def words(self) -> str:
        """As a sentence names it."""
        return f"sheet {self.n_x} x {self.n_y}"


class GivenSheet(Section):
    """A sheet of a given size."""

    sheet: SheetSize


PRESETS: Mapping[str, MeshSize] = {
    "coarse": MeshSize(n_x=6, n_y=40, n_z=2),
    "full": MeshSize(n_x=12, n_y=80, n_z=4),
    "sheet": SheetSize(n_x=12, n_y=80),
}

Mesh = Annotated[
    Annotated[Literal["coarse", "full", "sheet"], Tag("~word")] | Annotated[MeshSize, Tag("~size")] | Annotated[GivenSheet, Tag("~sheet")],
    Discriminator(_mesh_form),
]
"""`coarse` (6 x 40 x 2), `full` (12 x 80 x 4, the thesis), {n_x: ..., n_y: ..., n_z: ...}; one layer for a thin specimen: `sheet`
(12 x 80), {sheet: {n_x: ..., n_y: ...}}."""


def mesh_size(mesh: Literal["coarse", "full", "sheet"] | MeshSize | GivenSheet) -> MeshSize:
    """Numbers of elements of a preset or of a given size."""
    if isinstance(mesh, GivenSheet):
        return mesh.sheet
    return PRESETS[mesh] if isinstance(mesh, str) else mesh


def recorded_mesh(given: Any) -> MeshSize:
    """Numbers of elements of the mesh in the configuration of a record."""
    return mesh_size(_MESH.validate_python(given))


_MESH: TypeAdapter[Literal["coarse", "full", "sheet"] | MeshSize | GivenSheet] = TypeAdapter(Mesh)


class SpecimenOverride(Section):
    """Lengths in mm that replace those of experiment.yaml."""

    gauge_width: Positive | None = None
    thickness: Positive | None = None
    parallel_length: Positive | None = None
    shoulder_radius: Positive | None = None
    grip_width: Positive | None = None
    total_length: Positive | None = None
    gripped_length: Positive | None = None
