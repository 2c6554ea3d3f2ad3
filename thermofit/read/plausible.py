"""Is what was read a test at all? Mistakes of unit, sign, clock and side are asked about before an identification is spent on them.

Every doubt is one sentence with what was found, what is expected and how to mend it. What cannot be a test is refused; what is only unusual
is a remark. Where the data are right all the same, the user says so once: `confirmed: [NAME]` in experiment.yaml or in the record.

What a measured test says of its material at a first look: elastic slope, largest nominal stress and strain.

They set starts and bounds of a new study, which are good to a factor, not to a percent.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError, ThermofitError
from thermofit.core.experiment import CELSIUS, CouponRecord, MeasuredTest, Specimen
from thermofit.observe.camera import CameraPose, pose_from_landmarks
from thermofit.observe.camera_motion import seen_across
from thermofit.observe.phases import noise_level
from thermofit.read.ranges import (
    BOTH_M,
    KN,
    MOVED_M,
    MOVED_UM,
    NOT_KN,
    OF_RECORDS,
    RANGES,
    THICKNESS_M,
    WIDTH_M,
    Doubt,
    Mistake,
    outside,
)
from thermofit.read.raw import read_experiment
from thermofit.read.raw_description import DESCRIPTION

_GAUGE = 0.4
"""Part of the parallel length on either side of the middle in which the strain is uniform enough."""
_SURE_STRAIN = 0.1
"""Relative standard error of a chord's strain from which on the chord counts."""
_LEAST_POINTS = 6


@dataclass(frozen=True)
class FirstLook:
    """Elastic slope and largest nominal stress in MPa, largest strain of the gauge length."""

    modulus: float
    stress: float
    strain: float


def looked_at(experiment: MeasuredTest) -> FirstLook | str:
    """The same of an experiment in memory with displacements.

    The steepest chord from the first stage counts: plastic flow makes chords shallower, noise within `_SURE_STRAIN` does not make them much
    steeper.
    """
    course = course_of(experiment)
    if isinstance(course, str):
        return course
    modulus, largest = course.modulus, float(np.abs(course.stress).max())
    if modulus is None or not largest > 0.0:
        return "no strain stands clear of its noise while the force rises"
    low, high = RANGES["modulus"].possible
    if not low < modulus < high:
        return f"its elastic slope would be {modulus:.3g} MPa, which is that of no metal: check units, axes and clocks"
    return FirstLook(modulus, largest, float(np.abs(course.strain).max()))


@dataclass(frozen=True)
class Course:
    """Nominal stress MPa and mean strain of the gauge length over time s, both (n,) from their first values; `sigma` (n,) is the standard
    error of the strain."""

    time: np.ndarray
    strain: np.ndarray
    stress: np.ndarray
    sigma: np.ndarray

    @property
    def modulus(self) -> float | None:
        """Steepest chord from the first value up to the largest stress; None where no strain stands clear of its noise."""
        end = int(np.argmax(np.abs(self.stress)))
        sure = np.flatnonzero(np.hypot(self.sigma, self.sigma[0]) < _SURE_STRAIN * np.abs(self.strain))
        sure = sure[(sure > 0) & (sure <= end)]
        return float(np.max(self.stress[sure] / self.strain[sure])) if len(sure) else None


def course_of(experiment: MeasuredTest) -> Course | str:
    """Stress and strain of an experiment with displacements, or in words why there are none."""
    assert experiment.dic is not None
    strain, sigma = _gauge_strain(experiment)
    force = np.interp(experiment.dic.time, experiment.force.time, experiment.force.force)
    stress = force / (experiment.specimen.gauge_width * experiment.specimen.thickness)
    known = np.flatnonzero(np.isfinite(strain))
    if len(known) < 3:
        return f"only {len(known)} stages have {_LEAST_POINTS} points or more in the gauge length"
    first = known[0]
    return Course(experiment.dic.time[known], strain[known] - strain[first], stress[known] - stress[first], sigma[known])


def _gauge_strain(experiment: MeasuredTest) -> tuple[np.ndarray, np.ndarray]:
    """Mean strain along y of the gauge length and its standard error, each (n_t,), NaN in stages with too few points.

    Slope of u_y over y by least squares; its error is that of the scatter about the line.
    """
    assert experiment.dic is not None
    place, moved = experiment.dic.reference[:, :2], experiment.dic.displacement[:, :, 1]
    inside = (np.abs(place[:, 1]) < _GAUGE * experiment.specimen.parallel_length) & (np.abs(place[:, 0]) < experiment.specimen.gauge_width)
    strain, sigma = np.full(len(moved), np.nan), np.full(len(moved), np.nan)
    for n, u in enumerate(moved):
        used = inside & np.isfinite(u) & np.isfinite(place[:, 1])
        y = place[used, 1] - place[used, 1].mean() if used.any() else np.zeros(0)
        if used.sum() < _LEAST_POINTS or not (size := float(y @ y)) > 0.0:
            continue
        strain[n] = y @ u[used] / size
        left = u[used] - u[used].mean() - strain[n] * y
        sigma[n] = np.sqrt(left @ left / (used.sum() - 2) / size)
    return strain, sigma


_SURE = 5.0
"""Standard errors by which a sign must be sure."""
_WHOLE_KELVIN = 15.0
"""K within which a difference of 273.15 K is that of Celsius and Kelvin."""
_EVEN = 20.0
"""K between the 1st and 99th percentile of a frame up to which it shows nothing hot."""
_LEAST_CONDUCTIVITY = 5.0
"""mW/(mm K): metals conduct better; Ti-6Al-4V 6.7."""
_SMALL, _LARGE = 1.0 / 300.0, 300.0
"""Ratio of two clocks, or of two lengths, beyond which a unit is wrong by a thousand and not a test unusual."""
_TWICE = 0.01
"""Share of points that may lie where another one lies."""
_THIN = 1e-3
"""Width of a field over its length below which it is a line."""
_QUIET = 12.0
"""Range of a force over its noise up to which it is noise."""
_RECORD_LENGTH = 100.0
"""mm: largest length of a coupon over which heat flows off; its record does not say it."""


@dataclass(frozen=True)
class Question:
    """A doubt: the `name` by which it is confirmed, one sentence, and whether the data make no sense as they are."""

    name: Doubt
    text: str
    nonsense: bool = False


def settled(questions: Iterable[Question], confirmed: Collection[str], where: str) -> tuple[str, ...]:
    """Remarks on what is only unusual. DataError with the first sentence about what makes no sense; what is confirmed is not asked."""
    asked = [q for q in questions if q.name not in confirmed]
    for question in asked:
        if question.nonsense:
            raise DataError(f"{where}: {question.text}; if it is right as it is, say 'confirmed: [{question.name}]' there")
    return tuple(f"{q.text} (if it is right: 'confirmed: [{q.name}]')" for q in asked)


def questions_of_test(experiment: MeasuredTest, pose: CameraPose | None = None) -> tuple[Question, ...]:
    """Doubts about a test under cameras, about as much of it as was read; with the `pose` also about the side that the camera sees."""
    found = [*_specimen(experiment.specimen), *_force(experiment), *_surroundings(experiment)]
    if experiment.dic is not None:
        place = list(_place(experiment))
        found += place
        if not any(q.nonsense for q in found):
            found += _mechanics(experiment)
        found += _crosshead(experiment)
        if pose is not None and experiment.ir is not None:
            found += _side(experiment, pose)
    else:
        found += _stress(experiment)
    found += _clocks(experiment)
    if experiment.ir is not None:
        found += _frames(experiment)
    return tuple(found)


def asked(experiment: MeasuredTest, pose: CameraPose | None = None) -> tuple[str, ...]:
    """Remarks on a test; DataError, with the mend, where it makes no sense and its experiment.yaml does not confirm it."""
    return settled(questions_of_test(experiment, pose), experiment.confirmed, str(experiment.folder / DESCRIPTION))


def first_look(folder: Path) -> tuple[FirstLook | str, tuple[str, ...]]:
    """What the raw folder of a test says of its material, or in words why it does not, and remarks on its plausibility. DataError where it
    makes no sense."""
    try:
        experiment = read_experiment(folder)
    except ThermofitError as error:
        return f"the data cannot be read yet ({error})", ()
    remarks = asked(experiment, pose_of(experiment))
    return ("the experiment has no displacements" if experiment.dic is None else looked_at(experiment)), remarks


def pose_of(experiment: MeasuredTest) -> CameraPose | None:
    """Pose of the infrared camera by the landmarks of the experiment; None without them. DataError where they contradict each other."""
    if experiment.landmarks is None or experiment.ir is None:
        return None
    return pose_from_landmarks(experiment.landmarks, experiment.ir.side, experiment.ir.frames.shape[1:])


def questions_of_record(record: CouponRecord, rate_is_given: bool = False) -> tuple[Question, ...]:
    """Doubts about the record of a coupon, in nominal strain and stress, s and K."""
    modulus = _elastic_line(record)
    largest = float(np.abs(record.strain).max())
    found = list(_units(float(np.abs(record.stress).max()), largest, modulus, OF_RECORDS, ("stress", "strain"), firm=False))
    if not rate_is_given:
        course = Course(record.time, record.strain, record.stress, np.zeros(record.strain.size))
        theta = record.temperature
        rise = 0.0 if theta is None else float(np.nanpercentile(theta, 99.0) - theta[0])
        found += _rate(course, rise, _RECORD_LENGTH)
    found += _sensor(record)
    return tuple(found)


_HOT = 700.0
"""K: iron and nickel have lost a quarter of their modulus there, and light metals melt soon."""
_EARLY, _LEAST_ON_LINE, _STRAIGHT = 0.3, 8, 0.03
"""Share of the largest stress up to which a record may be elastic, samples that must lie there, and their scatter about a line over the
stress at its end."""


def _elastic_line(record: CouponRecord) -> float | None:
    """Slope in MPa of the beginning of a record; None where it is no line, for a flow curve begins anywhere, and in heat, where metals
    creep."""
    if (record.theta_start or record.theta_air) > _HOT:
        return None
    stress, strain = record.stress - record.stress[0], record.strain - record.strain[0]
    early = int(np.argmax(np.abs(stress) >= _EARLY * np.abs(stress).max()))
    if record.over_plastic or early < _LEAST_ON_LINE or not np.ptp(strain[: early + 1]) > 0.0:
        return None
    x, y = strain[: early + 1], stress[: early + 1]
    slope, level = np.polyfit(x, y, 1)
    return float(slope) if float(np.std(y - slope * x - level)) < _STRAIGHT * abs(float(stress[early])) else None


def _shown(value: float) -> str:
    return f"{value:.3g}"


def _span(quantity: str) -> str:
    """The usual range in words."""
    known = RANGES[quantity]
    low, high = (f"{value:g}" for value in known.usual)
    return f"{low} to {high} {known.unit}".removesuffix(" 1")


def _units(
    stress: float,
    strain: float | None,
    modulus: float | None,
    mistakes: Sequence[Mistake],
    names: tuple[Doubt, Doubt],
    *,
    firm: bool = True,
) -> Iterator[Question]:
    """Those known of largest stress and strain and elastic slope, beside what metals show; the mistakes that would explain what is not
    possible.

    `names` of the question: where the stress leaves its range, and where the strain does. A slope that is not `firm`, because it holds the
    flexibility of a machine, makes no nonsense alone.
    """
    given = {"stress": stress, "strain": strain, "modulus": None if modulus is None else abs(modulus)}
    known = {quantity: value for quantity, value in given.items() if value is not None}
    left = {quantity: outside(quantity, value) for quantity, value in known.items()}
    if not firm and left["stress"] == left.get("strain") == "" and "modulus" in left:
        left["modulus"] = left["modulus"] and "usual"
    worst = "possible" if "possible" in left.values() else "usual" if "usual" in left.values() else ""
    if not worst:
        return
    where = [quantity for quantity, word in left.items() if word == worst]

    def right(mistake: Mistake) -> bool:
        factor = {"stress": mistake.stress, "strain": mistake.strain, "modulus": mistake.stress / mistake.strain}
        return not any(outside(quantity, factor[quantity] * value) for quantity, value in known.items())

    words = {"stress": "largest nominal stress", "strain": "largest strain", "modulus": "elastic slope"}
    said = " and ".join(f"the {words[q]} is {_shown(known[q])} {RANGES[q].unit}".removesuffix(" 1") for q in where)
    wanted = " and ".join(_span(q) for q in where)
    fitting = [mistake for mistake in mistakes if right(mistake)]
    name = names[1] if where == ["strain"] or (fitting and all(m.stress == 1.0 for m in fitting)) else names[0]
    if worst == "usual" and not fitting:
        yield Question(name, f"{said}, where metals have {wanted}: check the units")
        return
    asked = " or ".join(mistake.name for mistake in fitting)
    mend = " or ".join(mistake.mend for mistake in fitting)
    tail = f"is it {asked}? {mend[0].upper()}{mend[1:]}" if fitting else "check the units of force, lengths and displacements"
    yield Question(name, f"{said}, where metals have {wanted}: {tail}", nonsense=worst == "possible")


def _specimen(specimen: Specimen) -> Iterator[Question]:
    """Lengths of the specimen."""
    for key, quantity in (("thickness", "thickness"), ("gauge_width", "width"), ("parallel_length", "length")):
        value = getattr(specimen, key)
        word = outside(quantity, value)
        if not word:
            continue
        metres = not outside(quantity, 1e3 * value)
        asked = "is it in m? Give it in mm" if metres else "check its unit"
        text = f"specimen.{key}_mm is {_shown(value)}, where specimens have {_span(quantity)}: {asked}"
        yield Question("specimen", text, nonsense=word == "possible" or (metres and value < 0.1 * RANGES[quantity].usual[0]))


def _force(experiment: MeasuredTest) -> Iterator[Question]:
    """A force that never acts."""
    record = experiment.force
    size = float(np.ptp(record.force))
    noise = noise_level(record.time, record.force) if len(record.time) > _LEAST_SAMPLES else 0.0
    if size == 0.0:
        text = f"the force is {record.force[0]:g} N from beginning to end: the channel of the load cell was not exported; export it"
        yield Question("force", text, nonsense=True)
    elif size < _QUIET * noise:
        text = (
            f"the force changes by {_shown(size)} N, which is its noise of {_shown(noise)} N: the load cell saw no test; "
            "check which channel was exported"
        )
        yield Question("force", text, nonsense=True)


_LEAST_SAMPLES = 10


def _place(experiment: MeasuredTest) -> Iterator[Question]:
    """Points of DIC beside the outline of the specimen."""
    assert experiment.dic is not None
    specimen, place = experiment.specimen, experiment.dic.reference[:, :2]
    place = place[np.isfinite(place).all(axis=1)]
    if not len(place):
        return
    low, high = np.percentile(place, [1.0, 99.0], axis=0)
    size = high - low
    again = len(place) - len(np.unique(place, axis=0))
    if again > _TWICE * len(place):
        text = f"{again} of {len(place)} DIC points lie exactly where another one lies: export every point once, with its own coordinates"
        yield Question("place", text, nonsense=True)
        return
    if not size.min() > _THIN * size.max():
        text = f"all DIC points lie on one line, {_shown(size[0])} x {_shown(size[1])} mm: export both coordinates of the field"
        yield Question("place", text, nonsense=True)
        return
    room = np.array([max(specimen.gauge_width, specimen.grip_width), specimen.total_length])
    slack = 1.05 * room + 1.0
    middle = np.abs(0.5 * (low + high))
    found = (
        f"the DIC field covers {_shown(size[0])} x {_shown(size[1])} mm about ({0.5 * (low + high)[0]:.3g}, {0.5 * (low + high)[1]:.3g})"
    )
    wanted = f"the specimen {_shown(room[0])} x {_shown(room[1])} mm about (0, 0)"
    begin = f"{found}, {wanted}"
    if (size < _SMALL * room).all():
        text = "is the DIC field in m? Name its columns x_m, y_m, ux_m, uy_m, or give dic.unit: m"
    elif (1e-3 * size < room).all() and (size > 30.0 * room).all():
        text = "is the DIC field in um or px? Name its columns x_um, y_um, ux_um, uy_um, or give dic.unit or dic.mm_per_pixel"
    elif specimen.thickness > specimen.gauge_width and size[0] > specimen.gauge_width:
        text = "are width and thickness exchanged? Exchange gauge_width_mm and thickness_mm"
    elif (size > slack).any() and (size[::-1] <= slack).all():
        text = "are x and y exchanged? y is along the load; exchange the columns, or give dic.axes: {x: y, y: x}"
    elif (size <= slack).all() and (middle + 0.5 * size > 0.5 * slack).any():
        text = "where is the origin? Shift the coordinates to the centre of the specimen, or give dic.origin_mm"
    elif (size > slack).any():
        # A part that is cut out of a longer specimen on purpose looks the same.
        yield Question("place", f"{begin}: check the lengths of the specimen and the unit of the coordinates")
        return
    else:
        return
    yield Question("place", f"{begin}: {text}", nonsense=True)


def _mechanics(experiment: MeasuredTest) -> Iterator[Question]:
    """Stress, strain and elastic slope: units and signs of force and displacement; the strain rate tells of the clock."""
    course = course_of(experiment)
    if isinstance(course, str):
        return
    peak = int(np.argmax(np.abs(course.stress)))
    strain, stress = float(course.strain[peak]), float(course.stress[peak])
    sure = abs(strain) > _SURE * np.hypot(course.sigma[0], course.sigma[peak])
    if sure and strain * stress < 0.0:
        change = f"{'longer' if strain > 0 else 'shorter'} by {abs(strain):.2%}"
        text = (
            f"at the largest force ({stress:.3g} MPa) the specimen is {change}: the sign of the force or of the displacements along y is "
            "flipped; tension is positive, and y points to the crosshead"
        )
        yield Question("force", text, nonsense=True)
        return
    if sure and stress < 0.0:
        text = f"the specimen gets shorter under {stress:.3g} MPa: a compression test, or are the signs of force and displacement flipped?"
        yield Question("force", text)
    modulus = course.modulus if sure else None
    explained = [*_of_stress(experiment), MOVED_M, MOVED_UM]
    yield from _units(float(np.abs(course.stress).max()), float(np.abs(course.strain).max()), modulus, explained, ("force", "displacement"))
    rise = 0.0
    if experiment.ir is not None:
        warm = np.nanpercentile(experiment.ir.frames.reshape(len(experiment.ir.frames), -1), 99.0, axis=1)
        rise = float(warm.max() - warm[0])
    yield from _rate(course, rise, experiment.specimen.parallel_length)


def _stress(experiment: MeasuredTest) -> Iterator[Question]:
    """The largest nominal stress, where there are no displacements to go with it: units and sign of the force, lengths."""
    specimen, force = experiment.specimen, experiment.force.force
    area = specimen.gauge_width * specimen.thickness
    yield from _units(float(np.abs(force).max()) / area, None, None, _of_stress(experiment), ("force", "force"))
    if -float(force.min()) > float(force.max()):
        yield Question("force", f"the largest force is {_shown(float(force.min()))} N: a compression test, or is its sign flipped?")


def _of_stress(experiment: MeasuredTest) -> list[Mistake]:
    """Mistakes of a unit that would make the stress wrong."""
    specimen = experiment.specimen
    return [
        KN,
        *([NOT_KN] if any("force_kN" in remark for remark in experiment.force.remarks) else []),
        *([THICKNESS_M] if specimen.thickness < 0.1 else []),
        *([WIDTH_M] if specimen.gauge_width < 0.5 else []),
        *([BOTH_M] if specimen.gauge_width < 0.5 and specimen.thickness < 0.1 else []),
    ]


def _rate(course: Course, rise: float, length: float) -> Iterator[Question]:
    """The strain rate up to the largest strain, and whether a specimen of this length (mm) could get warmer by `rise` K at it.

    Plastic work heats by at most s e' L^2 / (8 k) in the steady state, with the jaws as the only sink: that takes seconds, not days.
    """
    peak = int(np.argmax(np.abs(course.strain - course.strain[0])))
    time = float(course.time[peak] - course.time[0])
    if peak < 1 or not time > 0.0:
        return
    rate = abs(float(course.strain[peak] - course.strain[0])) / time
    word = outside("rate", rate)
    power = float(np.abs(course.stress).max()) * rate
    most = power * length**2 / (8.0 * _LEAST_CONDUCTIVITY)
    slow = rate < _SLOW
    if slow and rise > 3.0 * most + 0.5:
        text = (
            f"the test takes {_shown(time)} s to its largest strain and warms by {rise:.2g} K, where plastic work at {rate:.2g} 1/s "
            f"gives less than {_shown(most)} K: are the times in ms? Name them time_ms, or give unit: ms"
        )
        yield Question("time", text, nonsense=True)
    elif word:
        text = f"the strain rate is {rate:.2g} 1/s ({_shown(time)} s to the largest strain), usual are {_span('rate')}: are the times in s?"
        yield Question("time", text, nonsense=word == "possible")


_SLOW = 2e-5
"""1/s: below it the work of plastic flow is carried off as fast as it comes."""


def _clocks(experiment: MeasuredTest) -> Iterator[Question]:
    """The clock of the force beside that of the stages, or of the frames where there are none: one of them in ms."""
    field, what = (experiment.ir, "infrared frames") if experiment.dic is None else (experiment.dic, "DIC stages")
    if field is None or len(field.time) < 2 or not (stages := float(np.ptp(field.time))) > 0.0:
        return
    force = float(np.ptp(experiment.force.time))
    if force / stages > _LARGE:
        text = f"the force record lasts {_shown(force)} s, the {what} {_shown(stages)} s: is the force in ms? Name its column time_ms"
        yield Question("time", text, nonsense=True)


def _crosshead(experiment: MeasuredTest) -> Iterator[Question]:
    """Travel of the crosshead beside the elongation that DIC saw."""
    assert experiment.dic is not None
    if experiment.force.crosshead is None:
        return
    seen = experiment.dic.displacement[:, :, 1]
    if not np.isfinite(seen).any():
        return
    moved, travel = float(np.nanpercentile(np.abs(seen), 99.0)), float(np.ptp(experiment.force.crosshead))
    if moved > 0.0 and travel > 0.0 and not _SMALL < travel / moved < _LARGE:
        text = (
            f"the crosshead travels {_shown(travel)} mm and the DIC points move by up to {_shown(moved)} mm: "
            "is the column crosshead_mm in mm? Name it crosshead_m or crosshead_um"
        )
        yield Question("displacement", text)


def _surroundings(experiment: MeasuredTest) -> Iterator[Question]:
    """Temperatures of air and jaws."""
    air, jaws = experiment.theta_air, experiment.theta_clamp
    key = "temperatures.theta_{}_degC is {:.2f}"
    if abs(abs(air - jaws) - CELSIUS) < _WHOLE_KELVIN:
        name, value = ("air", air) if air > jaws else ("clamp", jaws)
        other = "clamp" if name == "air" else "air"
        text = (
            f"{key.format(name, value - CELSIUS)} and that of {other} {min(air, jaws) - CELSIUS:.2f}: is the first one in K? "
            "Give both in degC"
        )
        yield Question("temperature", text, nonsense=True)
        return
    for name, value in (("air", air), ("clamp", jaws)):
        if outside("surroundings", value) == "possible" or _in_kelvin(value):
            text = f"{key.format(name, value - CELSIUS)}: is it a hot test, or a temperature in K? Give degC"
            yield Question("temperature", text, nonsense=outside("surroundings", value) == "possible")


def _in_kelvin(kelvin: float) -> bool:
    """Would the number, read as K and not as degC, be that of a room?"""
    low, high = RANGES["surroundings"].usual
    return low <= kelvin - CELSIUS <= high


def _frames(experiment: MeasuredTest) -> Iterator[Question]:
    """Temperatures of the infrared frames beside those of air and jaws."""
    assert experiment.ir is not None
    first = experiment.ir.frames[0]
    low, middle, high = (float(v) for v in np.nanpercentile(first, [1.0, 50.0, 99.0]))
    coldest, hottest = float(np.nanmin(experiment.ir.frames)), float(np.nanmax(experiment.ir.frames))
    around = 0.5 * (experiment.theta_air + experiment.theta_clamp)
    for value in (coldest, hottest):
        if outside("temperature", value) == "possible":
            text = f"the infrared frames reach {value - CELSIUS:.4g} degC: are they temperatures in degC? Export them so"
            yield Question("temperature", text, nonsense=True)
            return
    away = middle - around
    if abs(abs(away) - CELSIUS) < _WHOLE_KELVIN and high - low < _EVEN:
        what = "the frames" if away > 0.0 else "the temperatures of air and jaws"
        text = (
            f"the first infrared frame shows {middle - CELSIUS:.4g} degC all over, air and jaws are at {around - CELSIUS:.4g} degC: are "
            f"{what} in K? Give all of them in degC"
        )
        yield Question("temperature", text, nonsense=True)


def _side(experiment: MeasuredTest, pose: CameraPose) -> Iterator[Question]:
    """The side that the camera sees, by the sideways motion that it and DIC both see."""
    assert experiment.ir is not None and experiment.dic is not None
    found = seen_across(pose, experiment.ir, experiment.dic, experiment.specimen)
    if found is None or found.slope > 0.0 or abs(found.slope) < _SURE * found.sigma:
        return
    if not 0.5 < -found.slope < 2.0:
        text = (
            f"sideways the specimen moves {found.slope:.2f} times as far in the infrared frames as for DIC, 1 is expected: "
            "check the clocks, the side and the landmarks"
        )
        yield Question("side", text)
        return
    text = (
        f"sideways the specimen moves the other way in the infrared frames than for DIC (factor {found.slope:.2f}, standard error "
        f"{found.sigma:.2f}): the camera's x is mirrored; correct ir.side, which is {pose.side}, or mirror the frames and landmarks back"
    )
    yield Question("side", text, nonsense=True)


def _sensor(record: CouponRecord) -> Iterator[Question]:
    """The sensor of a coupon beside what is said of the temperature before the test."""
    theta = record.temperature
    if theta is None or not np.isfinite(theta).any():
        return
    low, high = float(np.nanmin(theta)), float(np.nanmax(theta))
    start = float(theta[np.isfinite(theta)][0])
    said = record.theta_start if record.theta_start is not None else record.theta_air
    if "possible" in (outside("temperature", low), outside("temperature", high)):
        text = f"the sensor shows {low:.4g} to {high:.4g} K, which is no specimen: check the unit of the column of the temperature"
        yield Question("temperature", text, nonsense=True)
    elif abs(abs(start - said) - CELSIUS) < _WHOLE_KELVIN:
        text = (
            f"the sensor begins at {start - CELSIUS:.4g} degC, the test at {said - CELSIUS:.4g} degC: is one of them in K? "
            "Give the unit of the column, and initial_temperature_degC in degC"
        )
        yield Question("temperature", text, nonsense=True)
    elif _in_kelvin(start) and start == said:
        yield Question(
            "temperature", f"the sensor begins at {start - CELSIUS:.4g} degC: is it a hot test, or a temperature in K? Give its unit"
        )
