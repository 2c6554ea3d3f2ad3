"""`mesh`: the mesh that a study describes, checked, counted and drawn."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import matplotlib

from thermofit.body.mesh.mesh import Mesh
from thermofit.body.mesh.quality import quality, symmetry_of
from thermofit.body.mesh.specimen import imported, specimen_mesh
from thermofit.core.errors import StudyError
from thermofit.core.experiment import Specimen
from thermofit.experiment.static import static_specimen
from thermofit.read.raw_description import read_description
from thermofit.records.artefact import Dataset
from thermofit.records.staging import Made, Outcome, job, produce
from thermofit.report.figures import STYLE, save_figures
from thermofit.report.figures_mesh import mesh_figure
from thermofit.study.study import Study

NAME = "mesh"


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record with nodes, elements and sets, and `<run_dir>/mesh.png`. Errors of the makers; NumericsError for a mesh that is not sound.

    Of several experiments it is that of the first, in its folder.
    """
    if study.fitted:
        return run(study.one_of(study.fitted[0]), force=force)
    inputs: dict[str, Path] = {} if study.mesh_file is None else {"mesh": study.mesh_file}
    if study.static is None and not study.virtual:
        inputs["experiment"] = study.experiment / "experiment.yaml"
    task = job(study.run_dir, NAME, study.config_of("mesh", "geometry", "specimen", "static", "simulate"), inputs)
    outcome = produce(task, lambda: _make(study), force=force)
    if outcome.fresh and not Path(str(outcome.record.summary["picture"])).exists():
        outcome = produce(task, lambda: _make(study), force=True)
    return outcome


def specimen_of(study: Study) -> Specimen:
    """The specimen of a study, wherever its lengths are: static test, virtual experiment or raw folder."""
    if study.static is not None:
        return static_specimen(study)
    if study.simulate is not None and study.virtual:
        return study.specimen_of(study.simulate.specimen.lengths())
    return study.specimen_of(read_description(study.experiment).specimen.lengths())


def _make(study: Study) -> Made:
    mesh = specimen_mesh(study.geometry, specimen_of(study), study.mesh_size, study.mesh_file)
    found, factor = quality(mesh), symmetry_of(mesh)
    try:
        with matplotlib.rc_context(STYLE):
            picture = save_figures(study.run_dir, {NAME: mesh_figure(mesh, study.name)})[0]
    except OSError as error:
        raise StudyError(f"mesh: '{study.run_dir}' cannot be written ({error}): expected a writable folder with free space") from error
    remarks = list(imported(study.geometry, study.mesh_file).remarks) if study.mesh_file is not None else []
    summary = {
        "verdict": f"{mesh.n_elements} hex8, {mesh.n_nodes} nodes, {found.volume:.6g} mm^3 of 1/{factor:g} of the body; closed, in one "
        f"piece, Jacobian ratio {found.jacobian_ratio:.2g} at least",
        "picture": str(picture),
        "quality": {**asdict(found), "symmetry": factor},
        "sets": _set_rows(mesh),
        "remarks": remarks,
    }
    return Made(_datasets(mesh), summary)


def _set_rows(mesh: Mesh) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = [{"set": name, "kind": "facets", "n": len(facets)} for name, facets in sorted(mesh.facets.items())]
    return rows + [{"set": name, "kind": "nodes", "n": len(ids)} for name, ids in sorted(mesh.node_sets.items())]


def _datasets(mesh: Mesh) -> dict[str, Dataset]:
    out = {"nodes": Dataset(mesh.nodes, "mm", ("node", "axis")), "hexes": Dataset(mesh.hexes, "1", ("element", "corner"))}
    out |= {f"facets/{name}": Dataset(facets, "1", ("facet", "corner")) for name, facets in mesh.facets.items()}
    return out | {f"node_sets/{name}": Dataset(ids, "1", ("node",)) for name, ids in mesh.node_sets.items()}
