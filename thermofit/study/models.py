"""The study file as pydantic models. Units: mm, s, N, K, MPa; every default is the one that a run uses."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, StrictBool, Tag, ValidationError, field_validator, model_validator

from thermofit.core.experiment import Landmarks
from thermofit.core.parameters import AT, acting, bare_name, param
from thermofit.core.parameters import THERMOCOUPLES as THERMOCOUPLES
from thermofit.core.slots import Slots
from thermofit.law.hardening.catalogue import hardening, hardening_laws
from thermofit.law.surface.catalogue import DEFAULT as DEFAULT_SURFACE
from thermofit.law.surface.catalogue import surface, surfaces
from thermofit.study.coupon import Coupon
from thermofit.study.errors import content_error, sentence
from thermofit.study.geometry import Geometry, StaticTest
from thermofit.study.literature import Candidates, LiteratureValues, check_literature
from thermofit.study.search import GridSearch, Sensitivity
from thermofit.study.section import (
    Count,
    HardeningName,
    Mesh,
    ModelNumber,
    NonNegative,
    Number,
    ParameterName,
    ParameterSettings,
    ParameterStart,
    Positive,
    Section,
    SheetSize,
    SpecimenOverride,
    SurfaceName,
    Times,
    Whole,
    check_law,
    expected,
    hardening_error,
    mesh_size,
    no_repeats,
    physical_error,
    surface_error,
    word_or,
)
from thermofit.study.stages import Channel, Free, Mask, PlasticStage, StageName, Stages, StageSettings, Window
from thermofit.study.virtual import Simulate


class OwnExperiment(Section):
    """One test of several. What is absent is that of the study."""

    experiment: str | None = None
    """Raw folder, relative to the study file; absent: a virtual experiment, in <run_dir>/<name>/raw."""
    held_out: StrictBool = False
    """True: predicted by `validate`, never fitted."""
    parameters: ParameterSettings = Field(default={})
    """Starts, or fixed values, of this test's own parameters, such as alpha_air."""
    fit_own: Annotated[tuple[ParameterName, ...], AfterValidator(no_repeats)] = ()
    """Of a held-out test: its own boundary and measurement parameters that are fitted on its own data before it is predicted."""
    specimen: SpecimenOverride | None = None
    windows: dict[StageName, Window] = Field(default={})
    """Windows of the stages on this test."""
    simulate: dict[str, Any] | None = None
    """Keys of the section `simulate` that differ in this test, where it is virtual."""


ExperimentName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
Experiments = dict[ExperimentName, OwnExperiment]


def virtual_of(common: Simulate | None, own: OwnExperiment, number: int, key: str) -> Simulate | None:
    """The virtual experiment of a test: the study's, with its own keys; another seed for each. None where there is no `simulate`.

    Raises the error of the section where the keys do not fit.
    """
    if common is None or own.experiment is not None:
        return None
    tree = merged({**common.model_dump(mode="json"), "seed": common.seed + number}, own.simulate or {})
    try:
        return Simulate.model_validate(tree)
    except ValidationError as error:
        guilty, text = sentence(error.errors()[0])
        raise content_error(f"does not fit: {text}", key=f"{key}.simulate.{guilty}") from None


def merged(tree: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """A tree of keys with some of them changed, section by section."""
    out = dict(tree)
    for key, value in changes.items():
        inner = out.get(key)
        out[key] = merged(inner, value) if isinstance(inner, dict) and isinstance(value, dict) else value
    return out


def check_experiments(experiments: Experiments, common: Simulate | None, named: dict[str, str]) -> None:
    """Every test has data, and every name <param>@<test> (by the key that holds it) means one of them that is fitted."""
    for number, (name, own) in enumerate(experiments.items()):
        key = f"experiments.{name}"
        if own.experiment is None and common is None:
            raise content_error("is missing: name its raw folder, or describe a virtual experiment under 'simulate'", f"{key}.experiment")
        if own.fit_own and not own.held_out:
            raise content_error("is given, but this test is fitted anyway; leave it out, or add held_out: true", f"{key}.fit_own")
        virtual_of(common, own, number, key)
    for where, text in named.items():
        name = text.partition(AT)[2]
        if name and name not in experiments:
            raise content_error(f"names {text}, but there is no experiment '{name}' under 'experiments'", where)
        if name and experiments[name].held_out:
            raise content_error(f"names {text}, but '{name}' is held out; expected a test that is fitted", where)


Pixel = Annotated[tuple[Number, Number], expected("a pixel [row, col]")]


class EdgeMark(Section):
    """One pixel on an edge."""

    p1: Pixel
    note: str = ""


class EdgeMarks(EdgeMark):
    """Two pixels on one edge."""

    p2: Pixel


class LengthMark(EdgeMarks):
    """Two pixels [row, col] that lie `length_mm` apart."""

    length_mm: Positive


class CircleMarks(EdgeMarks):
    """Three pixels on a circle around the specimen's centre."""

    p3: Pixel


class PickedLandmarks(Section):
    """Landmarks of one frame; all four are needed."""

    length: LengthMark
    edge_left: EdgeMarks
    edge_right: EdgeMark
    circle: CircleMarks
    note: str = ""

    def of_frame(self, frame: int) -> Landmarks:
        """The same as arrays, picked in the frame of this number."""
        length, left, circle = self.length, self.edge_left, self.circle
        return Landmarks(
            frame=frame,
            length=np.array([length.p1, length.p2]),
            length_mm=length.length_mm,
            edge_left=np.array([left.p1, left.p2]),
            edge_right=np.array(self.edge_right.p1),
            circle=np.array([circle.p1, circle.p2, circle.p3]),
        )


Index = Annotated[Whole, Field(ge=0)]


class Necking(Section):
    """Equal force through every cross-section identifies the shape of the hardening curve (see docs/real-necking.md)."""

    file: str
    """Displacements of a grid of points at every frame, relative to the study file; may hold ${VARIABLES}."""
    load_axis: Literal["x", "y"]
    """Axis of the file along which the force acts."""
    hardening_rate: Annotated[Number, Field(gt=1)]
    """d ln(stress) / d(log. strain) in the necking section at the first frame: prescribed, because kinematics fix the law only up to it."""
    fit_frames: tuple[Index, Index]
    """First and last frame compared, counted from 0; the strain counts from the first one, later frames test the prediction."""
    rows: tuple[Index, Index] | None = None
    """First and last row of the grid that are used, counted from 0 along the load; null: all. Leave out fillets."""
    rows_per_section: Annotated[Whole, Field(ge=1)] = 4
    """Rows of the grid whose strain is averaged to that of one cross-section."""
    noise: Positive | None = None
    """Standard deviation of the strain of a section; null: estimated from its jumps from frame to frame."""

    @model_validator(mode="after")
    def _ranges_increase(self) -> Necking:
        for key, least in (("fit_frames", 4), ("rows", 2)):
            given = getattr(self, key)
            if given is not None and given[1] - given[0] < least:
                raise content_error(
                    f"is [{given[0]}, {given[1]}]; expected the first and the last one, at least {least} apart, counted from 0", key=key
                )
        return self


class Diagnosis(Section):
    """`diagnose` and `close-loop`: mesh, held-out data, number of effects."""

    channels: Annotated[tuple[Channel, ...], Field(min_length=1), AfterValidator(no_repeats)] | None = None
    """Channels of the joint model; null: all that the stages compare."""
    free: Free | None = None
    """Parameters that take part; null: all that any stage identifies, and the thermocouples with their error."""
    mesh: Mesh | None = None
    """Mesh of the joint model; null: that of the study, but not finer than `coarse` (of a sheet: 6 x 40). The error of mesh and steps is
    measured and counts."""
    held_out: Literal["blocks", "phases"] = "blocks"
    """What the fit does not see: buffered blocks of time and length, or whole load phases."""
    max_effects: Annotated[Whole, Field(ge=0, le=20)] = 3
    """Most effects that `close-loop` adds."""
    priors: dict[ParameterName, Positive | None] = Field(default={})
    """Standard error of a declared value in the unit of the parameter; null: none. For the thermocouples `theta_air`, `theta_clamp` it is
    0.1 K where nothing is given. For an effect it is that of its amplitude about neutral (`clamp_difference.difference` 0.5 K)."""

    @field_validator("priors")
    @classmethod
    def _declared(cls, given: dict[str, float | None]) -> dict[str, float | None]:
        """Thermocouples and amplitudes of effects; what a test identifies has no declared value."""
        for name in given:
            if AT in name or (name not in THERMOCOUPLES and ("." not in name or param(name).scan)):
                expected = f"{', '.join(THERMOCOUPLES)} or the amplitude <effect>.<param> of an effect, for all experiments"
                raise content_error(f"has no declared value; expected {expected}", key=name)
        return given


FROM_EXPERIMENT = tuple(name for name in acting("film", "reference") if param(name).unit == "K")
"""Parameters that need no start: thermocouples of the experiment give it."""


class MaterialAxes(Section):
    """How the sheet lies in the specimen; the Hill parameters (4.19) refer to its rolling direction as axis 2."""

    angle: Number = 0.0
    """Degrees from the load to the rolling direction about the thickness axis; a multiple of 90: the model is a quarter of the body."""

    @model_validator(mode="after")
    def _quarter_turns(self) -> MaterialAxes:
        if self.angle % 90.0 != 0.0:
            raise content_error(
                f"is {self.angle:g} degrees; expected a multiple of 90, which alone leaves the quarter model symmetric", key="angle"
            )
        return self


class EvaluationWindow(Section):
    """Nodes with |x| <= abs_x_max and |y| <= abs_y_max (mm) of the measured face are compared (thesis 5.1.2).

    With null the window goes as far as there are DIC points. On a dogbone and a bar it is at most 0.44 of the gauge width and 0.2 of the
    parallel length. These are 11 and 20 mm for the specimen of the thesis.
    """

    abs_x_max: Positive | None = None
    abs_y_max: Positive | None = None


class Evaluation(Section):
    """Where and when model and measurement are compared."""

    window: EvaluationWindow = EvaluationWindow()
    nodes: Mesh = "full"
    """Mesh whose face nodes are compared; predictions on another mesh are interpolated to them by its shape functions."""
    interpolation: Literal["projection", "three-point"] = "projection"
    """From points and pixels to nodes. `projection`: the mean of all in the patch of a node, with the prediction averaged over the same.
    `three-point`: linear between the three next ones (algorithms 2 and 3 of the thesis)."""
    displacement_times: Annotated[Annotated[Literal["stages"], Tag("~word")] | Annotated[Times, Tag("~times")], word_or("~times")] = (
        "stages"
    )
    """`stages` (every DIC stage) or a list of times in s."""
    temperature_times: Annotated[Annotated[Literal["frames"], Tag("~word")] | Annotated[Times, Tag("~times")], word_or("~times")] = "frames"
    """`frames` (every infrared frame) or a list of times in s."""
    reference_time: NonNegative | None = None
    """Time t_0 of dtheta and of du in s (2.22), (2.23); null: the first observation, which must be before loading."""
    mask: Mask = ()
    """Regions that no stage sees: a scratch, a glare, a stage that failed."""


class Force(Section):
    """The measured force is prescribed as a load."""

    smoothing: Literal["phases", "none"] = "phases"
    """`phases`: smoothed to its noise level, phase by phase; `none`: as measured."""
    noise: Positive | None = None
    """Standard deviation of the load cell in N; null: estimated from the data."""
    drives: Literal["force", "crosshead", "dic"] = "force"
    """What loads the model. `force`: the measured force, or the motion of sections where the model cannot reach it. `crosshead`: the
    crosshead less `compliance` times the force. `dic`: the elongation that the DIC points show between the model's ends. Where the model is
    longer than their field, it is that between the outermost sections of the field. With crosshead or dic compare channel force."""
    compliance: NonNegative = 0.0
    """Compliance of the machine in mm/N, where the crosshead drives."""
    band: Positive = 2.0
    """Where DIC drives: points within this many mm of the two sections give the elongation."""


class Infrared(Section):
    """What `calibrate-ir` takes instead of experiment.yaml, and how it reads the frames."""

    landmarks: PickedLandmarks | None = None
    landmarks_frame: Annotated[Whole, Field(ge=0)] | None = None
    rotation_deg: Annotated[Number, Field(gt=-45, lt=45)] | None = None
    """Roll of the camera in degrees; null: from the edge (Algorithm 1)."""
    refine: StrictBool = True
    """Refine centre and roll on the visible edges of the specimen after Algorithm 1, where their contrast suffices."""
    edge_margin: NonNegative = 1.0
    """Pixels nearer than this to the specimen's edge (mm) are blurred and left out."""
    blur: NonNegative = 0.0
    """Standard deviation of the camera's point spread in pixels; the prediction is blurred by it (projection only)."""


class Noise(Section):
    """Standard deviations of the raw data; null: estimated from the data."""

    displacement: Positive | None = None
    """In-plane noise of one DIC point, mm."""
    temperature: Positive | None = None
    """Noise of one pixel, K."""


class Uncertainty(Section):
    """What is known of the errors of what is prescribed: standard uncertainties, combined with those of the data. What is not stated
    counts as exact. Thermocouples: `diagnosis.priors`."""

    force_class: Positive | None = None
    """Class of the testing machine after ISO 7500-1 (0.5, 1, 2, 3): its force is within so many percent."""
    thickness: Positive | None = None
    """Standard uncertainty of the thickness, mm."""
    width: Positive | None = None
    """Standard uncertainty of the width of the gauge, mm."""
    camera_scale: Positive | None = None
    """Relative standard uncertainty of the scale of the displacements."""
    infrared_gain: Positive | None = None
    """Relative standard uncertainty of temperature differences seen by the infrared camera: its calibration and the emissivity."""
    parameters: dict[ParameterName, Positive] = Field(default={})
    """Standard uncertainties of parameters that the study prescribes, by name, in their units, as if independent of each other. A test
    without displacements takes its mechanical parameters so."""


class Numerics(Section):
    """How the forward model is solved."""

    steps_per_interval: Count = 1
    """Solution steps between two neighbouring required times."""
    max_time_step: Positive = 5.0
    """s"""
    plastic_integration: Literal["closed-form", "backward-euler"] = "closed-form"
    heat_integration: Literal["sdirk2", "backward-euler"] = "sdirk2"
    newton_tolerance: Annotated[Number, Field(ge=1.0e-12, le=1.0e-3)] = 1.0e-5
    """Residual of equilibrium beside the forces in the body; 1.0e-5 is about 1e-5 mm. Below 1e-11 round-off decides."""
    coupling_tolerance: Positive = 1.0e-3
    """Change of temperature at which the staggered coupling has converged, K."""
    force_tolerance: Positive = 2.0
    """Solution steps are set so that the force is straight between them within this many N."""
    coarse_start: StrictBool = True
    """On a finer mesh the optimum of the coarse mesh is the start."""
    threads: Count = 2


class Sections(Section):
    """All sections whose values mean the same in the file and in the loaded study."""

    name: Annotated[str, Field(pattern=r"^[.]*[A-Za-z0-9_-][A-Za-z0-9_.-]*$")]
    """Name of the study; letters, digits and _ . -"""
    model: ModelNumber = 2
    """Model 1 (associated, 4.6) or 2 (non-associated, 4.7) of the thesis: hardening voce or model2."""
    hardening: HardeningName | None = None
    """Hardening law by its name; null: that of `model`."""
    yield_surface: SurfaceName = DEFAULT_SURFACE
    """Yield surface by its name."""
    mesh: Mesh = "full"
    """A mesh of the body, or `sheet`: one layer for a thin specimen, which `verify` checks on the body."""
    geometry: Geometry = Geometry()
    specimen: SpecimenOverride = SpecimenOverride()
    static: StaticTest | None = None
    material_axes: MaterialAxes = MaterialAxes()
    parameters: ParameterSettings = Field(default={})
    """Start (or fixed) values by name: a number, or {start: ..., bounds: [.., ..], scale: ...}."""
    evaluation: Evaluation = Evaluation()
    force: Force = Force()
    ir: Infrared = Infrared()
    noise: Noise = Noise()
    uncertainty: Uncertainty = Uncertainty()
    numerics: Numerics = Numerics()
    stages: Stages = Stages()
    gridsearch: GridSearch | None = None
    sensitivity: Sensitivity | None = None
    diagnosis: Diagnosis = Diagnosis()
    simulate: Simulate | None = None
    coupon: Coupon | None = None
    """Uniaxial records instead of, or besides, a full-field experiment."""
    experiments: Experiments = Field(default={})
    """Several tests that share the material parameters, by name; with held_out: true one that is predicted, not fitted."""
    shared: Annotated[tuple[ParameterName, ...], AfterValidator(no_repeats)] = ()
    """Boundary and measurement parameters that are the same in all experiments."""
    literature: LiteratureValues
    """Published values by parameter, or c_p: a number, a range [low, high], or {value: ..., sigma: ..., source: ...}."""
    compare: Candidates
    """Other models of the same data, by name, for `thermofit compare`."""
    necking: Necking | None = None
    """A necking test without force, alone in its study: the hardening law from equal force through all cross-sections."""

    @property
    def hardening_law(self) -> str:
        """Name of the hardening law, by `hardening` or `model`."""
        return hardening(self.model).name if self.hardening is None else self.hardening

    @property
    def slots(self) -> Slots:
        """What stands in the slots of the base law."""
        return Slots(self.hardening_law, self.yield_surface)

    @model_validator(mode="after")
    def _physics(self) -> Sections:
        """Starts, truth and grid are physical, and every stage that the study lists has its starts."""
        starts = {name: start_of(setting) for name, setting in self.parameters.items()}
        _check_several(self)
        check_literature(self.literature)
        for name, setting in self.parameters.items():
            _check_parameter(name, setting)
        _check_hardening(starts, self.hardening_law, "parameters")
        _check_surface(starts, self.yield_surface, "parameters.")
        for name in sorted(self.stages.model_fields_set):
            stage = getattr(self.stages, name)
            if "free" in stage.model_fields_set and (wrong := surface_error(stage.free, self.yield_surface)):
                raise content_error(f"holds {wrong[0]}, which {wrong[1]}", f"stages.{name}.free")
        if self.simulate is not None and self.static is not None:
            raise content_error("describes a measured field, but 'simulate' a virtual experiment; leave one of them out", "static")
        if self.simulate is not None:
            _check_hardening(self.simulate.truth, self.simulate.hardening_law or self.hardening_law, "simulate.truth")
            _check_surface(self.simulate.truth, self.simulate.yield_surface or self.yield_surface, "simulate.truth.")
        for name in sorted(self.stages.model_fields_set):
            stage = getattr(self.stages, name)
            if self.coupon is not None and "free" not in stage.model_fields_set:
                continue  # records of coupons have other defaults
            if missing := check_starts(stage, starts):
                raise content_error(f"is missing, but stage {name} identifies it: add its start", f"parameters.{missing}")
        for index, trial in enumerate(self.gridsearch.starts if self.gridsearch else ()):
            key = f"gridsearch.starts.{index}"
            _check_hardening({**starts, **trial}, self.hardening_law, key)
            _check_surface(trial, self.yield_surface, f"{key}.")
            for name, value in trial.items():
                low, high = bounds_of(name, self.parameters.get(name))
                if not low <= value <= high:
                    raise content_error(f"is {value:g}; expected {low:g} to {high:g}, the bounds in parameters.{name}", f"{key}.{name}")
        _check_coupon(self)
        _check_sheet(self)
        if self.sensitivity is not None and self.sensitivity.quantity in getattr(self.stages, self.sensitivity.stage).free:
            quantity, stage = self.sensitivity.quantity, self.sensitivity.stage
            raise content_error(f"is {quantity}, which stages.{stage}.free identifies; expected a prescribed one", "sensitivity.quantity")
        return self


class StudyFile(Sections):
    """The study file as it is written. Paths may hold ${VARIABLES} of the environment."""

    experiment: str | None = None
    """Raw folder, relative to the study file. Absent: the virtual experiment of `simulate`, in <run_dir>/raw, or only `coupon` records."""
    effects: tuple[str, ...] = ()
    """Effect files of your own, relative to the study file; their Params are called <file>.<param>."""
    run_dir: str | None = None
    """Where artefacts and figures go, relative to the current directory; absent: runs/<name>."""

    @model_validator(mode="before")
    @classmethod
    def _freed(cls, tree: Any) -> Any:
        """Stage plastic of a full-field test frees what the chosen hardening law and yield surface have, where the study does not say."""
        if not isinstance(tree, dict) or tree.get("coupon"):
            return tree
        laws, known = [law.name for law in hardening_laws()], [one.name for one in surfaces()]
        law, yields = tree.get("hardening"), tree.get("yield_surface", DEFAULT_SURFACE)
        stages = tree.get("stages") or {}
        plastic = stages.get("plastic", {}) if isinstance(stages, dict) else None
        usual = PlasticStage().free
        free = hardening(law).exchanged(usual, hardening(1)) if law in laws else usual
        free = surface(yields).exchanged(free, surface(DEFAULT_SURFACE)) if yields in known else free
        if not isinstance(plastic, dict) or "free" in plastic or free == usual:
            return tree
        return {**tree, "stages": {**stages, "plastic": {**plastic, "free": list(free)}}}

    @model_validator(mode="after")
    def _has_data(self) -> StudyFile:
        check_law(self.model if "model" in self.model_fields_set else None, self.hardening)
        others = [key for key in ("experiment", "simulate", "coupon", "static") if getattr(self, key) is not None]
        if self.necking is not None and others:
            raise content_error(f"is a study of its own, but '{others[0]}' is given too; leave one of them out", "necking")
        if fitted := [name for name, own in self.experiments.items() if not own.held_out]:
            if others := [key for key in ("experiment", "coupon", "static", "necking") if getattr(self, key) is not None]:
                text = f"is given, and so is '{fitted[0]}' under 'experiments'; put all tests that are fitted under 'experiments'"
                raise content_error(text, others[0])
        elif self.experiment is None and self.simulate is None and self.coupon is None and self.necking is None:
            raise content_error(
                "is missing: name the raw folder, or describe a virtual experiment under 'simulate' or records under 'coupon'", "experiment"
            )
        if self.experiments and (self.coupon is not None or self.static is not None or self.necking is not None):
            raise content_error("holds full-field tests beside another kind; give coupon records under 'coupon.records'", "experiments")
        return self


def _check_coupon(sections: Sections) -> None:
    """Channels that only coupons have; flow curves over plastic strain, which know nothing of E."""
    stages = {key: getattr(sections.stages, key) for key in ("elastic", "plastic", "thermal")}
    if sections.coupon is None:
        for key, stage in stages.items():
            if "lateral" in stage.channels:
                raise content_error("is a channel of coupon records; expected strain or du", f"stages.{key}.channels.lateral")
        return
    curves = [record.label for record in sections.coupon.records if record.over_plastic]
    if not curves:
        return
    text = f"'{curves[0]}' is a flow curve over plastic strain, which knows nothing of E"
    if not is_prescribed(sections.parameters, "E"):
        raise content_error(f"is not prescribed, but record {text}; expected a number in MPa, without start and bounds", "parameters.E")
    freed = {f"stages.{key}.free": stage.free for key, stage in stages.items() if "free" in stage.model_fields_set}
    for key, free in {**freed, "diagnosis.free": sections.diagnosis.free or ()}.items():
        if "E" in free:
            raise content_error(f"holds E, but record {text}; leave it out", key)


def _check_sheet(sections: Sections) -> None:
    """A mesh from a file has the layers that it has."""
    asked = {"mesh": sections.mesh, "diagnosis.mesh": sections.diagnosis.mesh, "evaluation.nodes": sections.evaluation.nodes}
    for key, mesh in asked.items():
        if sections.geometry.shape == "file" and mesh is not None and isinstance(mesh_size(mesh), SheetSize):
            raise content_error("asks for a sheet, but the mesh of geometry.file stays as it is; leave the key out", key)


def _check_several(sections: Sections) -> None:
    """Experiments have their data; parameters of one experiment are named where that experiment is known."""
    named = {f"parameters.{name}": name for name in sections.parameters}
    for key in ("elastic", "plastic", "thermal"):
        named |= {f"stages.{key}.free": name for name in getattr(sections.stages, key).free if AT in name}
    check_experiments(sections.experiments, sections.simulate, named)
    for name, own in sections.experiments.items():
        for parameter, setting in own.parameters.items():
            _check_parameter(parameter, setting, f"experiments.{name}.parameters.{parameter}")
    if sections.shared and not sections.experiments:
        raise content_error("is given, but there is only one experiment; leave it out", "shared")


def is_prescribed(parameters: Mapping[str, float | ParameterStart], name: str) -> bool:
    """True where a study gives a parameter as a plain number; {start: ...} is one to be identified."""
    return name in parameters and not isinstance(parameters[name], ParameterStart)


def start_of(setting: float | ParameterStart) -> float:
    """Start value of a parameter's setting."""
    return setting.start if isinstance(setting, ParameterStart) else setting


def bounds_of(name: str, setting: float | ParameterStart | None) -> tuple[float, float]:
    """Bounds of a parameter: the study's, else the physical ones."""
    if isinstance(setting, ParameterStart) and setting.bounds is not None:
        return setting.bounds
    return param(name).lower, param(name).upper


def check_starts(settings: StageSettings, given: Container[str]) -> str | None:
    """The first free parameter of a stage that has no start value in the study, None where all have one."""
    names = (bare_name(name) for name in settings.free if name not in given)
    return next((name for name in names if name not in given and name not in FROM_EXPERIMENT), None)


def _check_parameter(name: str, setting: float | ParameterStart, key: str = "") -> None:
    """Start inside the bounds, bounds in order and inside the physical ones."""
    low, high = bounds_of(name, setting)
    key = key or f"parameters.{name}"
    if low >= high:
        raise content_error(f"is [{low:g}, {high:g}]; expected the lower bound first, and below the upper one", f"{key}.bounds")
    for bound in (low, high):
        if text := physical_error(name, bound):
            raise content_error(f"holds a bound that {text}; the study may narrow the physical bounds, not widen them", f"{key}.bounds")
    start = start_of(setting)
    if text := physical_error(name, start):
        raise content_error(text, key if not isinstance(setting, ParameterStart) else f"{key}.start")
    if not low <= start <= high:
        raise content_error(f"is {start:g}, outside its bounds [{low:g}, {high:g}]; expected a start between them", f"{key}.start")


def _check_surface(names: Iterable[str], chosen: str, key: str) -> None:
    """No Param of another yield surface."""
    if wrong := surface_error(names, chosen):
        raise content_error(wrong[1], f"{key}{wrong[0]}")


def _check_hardening(values: Mapping[str, float], law: str, key: str) -> None:
    """The law rises: M_yinf > M_y0."""
    if wrong := hardening_error(values, law):
        raise content_error(wrong[1], f"{key}.{wrong[0]}")
