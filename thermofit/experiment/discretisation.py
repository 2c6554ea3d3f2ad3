"""The errors of mesh and time steps in what a run shows, by Richardson's extrapolation, and the data with these errors in them.

On elements of size h a prediction is p_h = p_0 + C h^2 + o(h^2), so that a mesh finer by r tells its error:
p_h - p_0 = (p_h - p_(h/r)) / (1 - 1/r^2). Half the steps tell theirs in the same way, by the order of the heat integration. The one layer
of a sheet is the coarsest division of the thickness: a body with n_z layers and the same elements in the plane tells what it misses, with
r = n_z. All of them hardly depend on the parameters. A coarse model is therefore compared with the data plus these errors (a deferred
correction, Stetter 1978, Numerische Mathematik 29, 425-443): it fits and is judged as the extrapolated one would be, at the cost of the
coarse one.

C is smooth from node to node. Inside an element a bilinear field is off by an arc, up to h^2/8 of its second derivative and zero at the
nodes. Arcs of two meshes differ in length, so that no power of h takes one into the other, and their extrapolation is no error of anything.
With S p the values of p that are read off smoothly between the nodes (`observe.observation.smooth_operator`), the error is

    p_h - p_0 = (S p_h - S p_(h/r)) / (1 - 1/r^2)  +  (p_h - S p_h).

A specimen has no elements: its data hold both parts. Those of a virtual test on elements of size t hold 1 - (t/h)^2 of the first part, the
second, and arcs of their own, which are taken off: S p_(h/r) - p_(h/r), if t is about h/r.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from thermofit.body.mesh.planes import longest
from thermofit.body.mesh.specimen import specimen_mesh
from thermofit.body.solve.history import History
from thermofit.core.experiment import Specimen
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import Measured, displacement_of, temperature_of
from thermofit.experiment.force_error import with_force_error
from thermofit.experiment.joint import Joint, Known
from thermofit.experiment.missing import MissingTerm
from thermofit.experiment.missing_body import HEATING, BodyMissing
from thermofit.experiment.model import StageModel
from thermofit.experiment.prediction import Errors
from thermofit.fit.linear_model import LinearModel
from thermofit.observe.observation import FieldObservation, ReadsFace, face_operator, smooth_operator
from thermofit.records.progress import progress
from thermofit.study.section import MeshSize, SheetSize
from thermofit.study.study import Study

FINER = 1.5
"""Refinement r of the mesh that tells the error, at least."""
REMAINS = 0.5
"""Part of the error that is not trusted to be gone: an order between 1 and infinity in place of 2 would leave or overdo about as much."""
ORDER = {"sdirk2": 2, "backward-euler": 1}
"""Order of the error of the time steps, by `numerics.heat_integration`: heat is what they tell of."""
MESH, STEPS, SHEET = "mesh", "time steps", "sheet"
WITHIN, THEIRS = "mesh inside its elements", "mesh of the data inside its elements"
"""Parts of the error of the mesh beside MESH, the smooth one: arcs of its own elements, and those of a virtual test, taken off."""
OF_TERM = "mesh of what is missing"
"""The smooth error of a term that the model lacks. That of a spot no larger than an element does not go with h^2 yet, and may be told too
large. The data say how much of it they hold, and what they hold of the error of everything else does not hang on that."""
OF_A_SPECIMEN = {MESH: 1.0, WITHIN: 1.0, THEIRS: 0.0, OF_TERM: 1.0, STEPS: 1.0, SHEET: 1.0}
"""Shares of the errors that data of a specimen hold: it has no elements."""
NEAR = 1.5
"""Error of a channel over its noise up to which it tells what the data hold of the errors of a model; the limit of a misfit."""
_PLAIN = 3.0
"""Length of an error in the residual, in units of the noise, below which the data cannot say whether they hold it."""

Parts = Mapping[str, np.ndarray]
"""Errors (n,) in the residual that may be left, by cause."""


@dataclass(frozen=True)
class Discretised:
    """A joint problem whose data hold the errors of its mesh and steps, that part of them in the residual that may be left, by cause, the
    same where the force is taken as exact, the shares of them that the data show (0 to 1), and the run that told them, with its points."""

    joint: Joint
    causes: Parts
    causes_exact: Parts
    doubts: Parts
    doubts_exact: Parts
    """What of the correction is in doubt, by cause: the part that may be left of what the data hold; the same of an exact force."""
    shares: Mapping[str, float]
    """By cause; of the mesh by part: MESH, WITHIN and THEIRS, and OF_TERM beside a term that heats."""
    fields: Mapping[str, Errors]
    """The errors that the data hold, as fields, by cause and part."""
    known: Known
    """Error fields of the corrected problem at the given parameters, and their derivatives."""
    history: History

    @property
    def left(self) -> np.ndarray:
        """Error (n,) of mesh and steps that may be left in the residual."""
        return summed(self.causes)

    @property
    def left_exact(self) -> np.ndarray:
        """The same where the force is taken as exact."""
        return summed(self.causes_exact)

    def doubt(self, exact: bool) -> Parts:
        """What of the correction is in doubt, by cause, where the force is taken as exact or not."""
        return self.doubts_exact if exact else self.doubts

    @property
    def largest_strain(self) -> float:
        """Largest Lambda of the run."""
        return max(float(p.accumulated.max()) for p in self.history.points)


def summed(parts: Parts) -> np.ndarray:
    """All errors (n,) together."""
    return np.sum(list(parts.values()), axis=0)


def finer_mesh(size: MeshSize) -> MeshSize:
    """The mesh with FINER times as many elements along each axis, rounded up, along the load to an even number as dogbones need it; of a
    sheet in its plane."""
    counts = {axis: int(np.ceil(FINER * n)) for axis, n in size.counts.items()}
    return size.with_counts({**counts, "n_y": 2 * int(np.ceil(0.5 * FINER * size.n_y))})


def telling_mesh(study: Study, specimen: Specimen, size: MeshSize) -> MeshSize:
    """The mesh that tells the error of another one: the finer mesh, with as many more elements along the load as make those in the jaws
    finer too. StudyError as a mesh of the study raises it.

    What the jaws hold is a few elements long, and the temperature falls by much in each of them. Counts are whole numbers: with half as
    many again along the load as many may lie in the jaws as before, and then the finer mesh knows nothing of the error there. More elements
    end that: those of a grip are shared by length.
    """
    finer = finer_mesh(size)
    if study.geometry.shape == "file":
        return finer
    held, _ = longest(specimen_mesh(study.geometry, specimen, size))
    while True:
        inside, outside = longest(specimen_mesh(study.geometry, specimen, finer))
        if inside <= max(held / FINER, outside):
            return finer
        finer = finer.with_counts({**finer.counts, "n_y": finer.n_y + 2})


def left_by(size: MeshSize, other: MeshSize) -> float:
    """Error of another mesh over that of the first, h^2 of their elements in the plane."""
    return (size.n_x * size.n_y) / (other.n_x * other.n_y)


def numerical_errors(
    joint: Joint, parameters: Parameters, history: History, coarse: Errors, beside: MissingTerm | None = None
) -> dict[str, Errors]:
    """Errors of mesh, steps and, of a sheet, its one layer in the predicted fields of a joint problem, by cause and part; `history`,
    `coarse`: its run and errors; `beside`: a term that the model lacks, whose heat goes through the same mesh. NumericsError where a run
    fails."""

    heats = beside if beside is not None and beside.kind in HEATING else None

    def told(one: Joint, ran: History, errors: Errors, operator: ReadsFace = face_operator) -> Errors:
        return errors if heats is None else {**errors, "theta": errors["theta"] + one.warmed_by(heats, ran, parameters, operator)}

    size = telling_mesh(joint.study, joint.data.specimen, joint.size)
    finer, slower = replace(joint, size=size), replace(joint, substeps=2 * joint.substeps)
    finer_history, fine = finer.shown(parameters)
    bare, fine_bare = joint.smoothed(history, parameters), finer.smoothed(finer_history, parameters)
    smooth, fine_smooth = told(joint, history, bare, smooth_operator), told(finer, finer_history, fine_bare, smooth_operator)
    coarse, fine, slow = told(joint, history, coarse), told(finer, finer_history, fine), told(slower, *slower.shown(parameters))
    kept, gone = 0.5 ** ORDER[joint.study.numerics.heat_integration], 1.0 - left_by(joint.size, size)
    found = {
        MESH: {name: (bare[name] - fine_bare[name]) / gone for name in coarse},
        WITHIN: {name: coarse[name] - smooth[name] for name in coarse},
        THEIRS: {name: fine_smooth[name] - fine[name] for name in coarse},
        STEPS: {name: (coarse[name] - slow[name]) / (1.0 - kept) for name in coarse},
    }
    if heats is not None:
        found[OF_TERM] = {name: (smooth[name] - fine_smooth[name]) / gone - found[MESH][name] for name in coarse}
    if isinstance(joint.size, SheetSize):
        # The elements in the plane are the same, and so are their arcs.
        whole = replace(joint, size=joint.size.body)
        body = told(whole, *whole.shown(parameters))
        found[SHEET] = {name: (coarse[name] - body[name]) / (1.0 - sheet_on_mesh(joint.size.body)) for name in coarse}
    return found


def corrected(joint: Joint, parameters: Parameters, beside: MissingTerm | None = None) -> Discretised:
    """The joint problem that knows the errors of its mesh, steps and prescribed force at given parameters; `beside`: a term that the model
    lacks, whose own errors are among them. NumericsError where a run fails.

    Data of a specimen hold all of these errors, those of a virtual test on the same mesh nothing of them: the shares are those that the
    residual shows beyond what the fitted parameters, and the term, could take up.
    """
    with progress("errors of force, mesh and steps", None) as advance:
        history, coarse = joint.shown(parameters)
        joint = with_force_error(joint, parameters)
        advance(1, "of the force")
        errors = numerical_errors(joint, parameters, history, coarse, beside)
        advance(1, "of mesh and steps")
    exact = joint.without_force_error().model

    def told(model: StageModel) -> Parts:
        at = model.assemble(coarse)
        rows = {part: at - model.assemble({name: coarse[name] - error[name] for name in coarse}) for part, error in errors.items()}
        return {part: np.append(row, np.zeros(len(model.priors))) for part, row in rows.items()}

    own, own_exact = told(joint.model), told(exact)
    model, names = joint.model, parameters.free or joint.settings.free
    assert model.linearise is not None
    plain, slopes = model.linearise(parameters, names)
    residual, fitted = model.assembled(parameters, names, plain, slopes)
    shares = shares_held(own, residual, np.hstack([fitted, *_of_term(model, plain, parameters, history, beside)]), model.places)
    held = {part: {name: shares[part] * field for name, field in error.items()} for part, error in errors.items()}
    whole = {name: np.sum([error[name] for error in held.values()], axis=0) for name in coarse}
    return Discretised(
        replace(joint, data=_holding(joint.data, whole)),
        _left(own, OF_A_SPECIMEN),
        _left(own_exact, OF_A_SPECIMEN),
        _left(own, shares),
        _left(own_exact, shares),
        shares,
        held,
        ({name: error - whole[name] for name, error in plain.items()}, slopes),
        history,
    )


def _of_term(model: StageModel, plain: Errors, parameters: Parameters, history: History, beside: MissingTerm | None) -> list[np.ndarray]:
    """Columns (n, m) of the hats of a term that the model lacks, at parameters that it has run with; none where it lacks none."""
    if beside is None:
        return []
    assert isinstance(model.missing, BodyMissing), "a term is one of a body"
    adds = beside.by_units(model.missing.on(history, parameters), parameters)
    shown = {name: adds[name] if name in adds else np.zeros((*error.shape, len(beside.chosen))) for name, error in plain.items()}
    return [np.concatenate([model.assemble_jacobian(plain, shown), np.zeros((len(model.priors), len(beside.chosen)))])]


def _left(told: Parts, shares: Mapping[str, float]) -> Parts:
    """What may be left (n,) of shares of errors, by cause and part. The parts of the mesh are in doubt each by itself: an order of
    convergence says nothing of arcs, and what they make of a parameter may well cancel while each is half off."""
    return {part: REMAINS * shares[part] * rows for part, rows in told.items()}


def sheet_on_mesh(other: MeshSize) -> float:
    """Error of the layers of another mesh over that of the one layer of a sheet: h^2 through the thickness."""
    return float(other.n_z) ** -2


def on_mesh(fields: Mapping[str, Errors], size: MeshSize, other: MeshSize) -> Errors:
    """Errors of fields by cause, told on a mesh, as they are on another one together: that of the mesh goes with h^2, and the arcs of its
    elements stay with it."""
    same = (size.n_x, size.n_y) == (other.n_x, other.n_y)  # the elements of the face
    scales = {MESH: left_by(size, other), OF_TERM: left_by(size, other), WITHIN: 1.0 if same else 0.0, SHEET: sheet_on_mesh(other)}
    scales = {cause: scales.get(cause, 1.0) for cause in fields}
    return {name: np.sum([scales[cause] * error[name] for cause, error in fields.items()], axis=0) for name in next(iter(fields.values()))}


def shares_held(told: Parts, residual: np.ndarray, fitted: np.ndarray, places: Mapping[str, slice]) -> dict[str, float]:
    """Shares of errors (n,) that a residual (n,) shows beyond the columns (n, p) of the fitted parameters, each 0 to 1; of one that is too
    small to tell, what data of a specimen hold. `places`: rows of every channel.

    What a model lacks would be taken for an error of its mesh, or for the opposite of one. So a channel that is left far above its noise
    does not tell, and where none does, the data are taken for those of a specimen.
    """
    near = np.ones(len(residual), dtype=bool)
    while any(near[rows].any() for rows in places.values()):
        shares = _shares({cause: rows[near] for cause, rows in told.items()}, residual[near], fitted[near])
        left = np.zeros(len(residual))
        left[near] = LinearModel((residual - sum(shares[cause] * rows for cause, rows in told.items()))[near], fitted[near]).left
        far = [rows for rows in places.values() if near[rows].any() and float(np.mean(left[rows] ** 2)) > NEAR**2]
        if not far:
            return shares
        for rows in far:
            near[rows] = False
    return {cause: OF_A_SPECIMEN[cause] for cause in told}


def _shares(told: Parts, residual: np.ndarray, fitted: np.ndarray) -> dict[str, float]:
    """The same by all rows."""
    own = {cause: LinearModel(rows, fitted).left for cause, rows in told.items()}
    shares = {cause: OF_A_SPECIMEN[cause] for cause in told}
    plain = [cause for cause, rows in own.items() if float(rows @ rows) > _PLAIN**2]
    if plain:
        columns = np.stack([own[cause] for cause in plain], axis=1)
        rest = residual - sum(shares[cause] * own[cause] for cause in told if cause not in plain)
        whole = np.zeros(len(plain)), np.ones(len(plain))
        found = LinearModel(-rest, columns, bounds=whole).step.d
        shares |= {cause: float(share) for cause, share in zip(plain, found, strict=True)}
    return shares


def _holding(data: Measured, error: Errors) -> Measured:
    """Data with the errors of a model in them."""

    def seen(observation: FieldObservation) -> FieldObservation:
        return replace(observation, value=observation.value + error[observation.name])

    held = replace(data, displacement=seen(displacement_of(data))) if "u" in error else data
    if "theta" in error:
        held = replace(held, temperature=seen(temperature_of(data)))
    return replace(held, force=seen(data.force)) if "force" in error else held
