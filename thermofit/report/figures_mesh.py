"""Pictures of a mesh: its free faces from the outside with the film sets in colour, and the face with the node sets."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from thermofit.body.mesh.mesh import Mesh, boundary_facets
from thermofit.body.mesh.sets import facets_within
from thermofit.report.figures import new_figure

_FILMS = ("#9ecae1", "#fdae6b", "#a1d99b", "#bcbddc", "#fdd0a2", "#c7e9c0")
"""Colours of the facet sets in the order of their names."""
_PLANE = "0.85"
_MARKS = {"x0": ("tab:green", "|"), "z0": ("tab:purple", "x"), "bottom": ("tab:red", "v"), "top": ("tab:red", "^"), "face": ("black", ".")}
"""Colour and marker of the node sets."""
_VIEW = np.array([[0.80, -0.06, -0.60], [-0.21, 0.90, -0.37]])
"""Horizontal and vertical direction of the drawing in x, y, z: seen from the front, from the right and slightly from above."""


def mesh_figure(mesh: Mesh, title: str) -> Figure:
    """The free faces in parallel projection, and the face that the cameras see; every set in its colour, counted in the legend."""
    span = np.ptp(mesh.nodes, axis=0)
    height = 7.0
    width = float(np.clip(height * span[0] / span[1], 1.2, 6.0))
    figure = new_figure(2.0 * width + 4.2, height)
    left, right = figure.subplots(1, 2)
    colours = {name: _FILMS[k % len(_FILMS)] for k, name in enumerate(sorted(mesh.facets))}
    _outside(left, mesh, colours)
    _face(right, mesh)
    handles: list[Patch | Line2D] = [
        Patch(facecolor=c, edgecolor="0.3", label=f"{n}: {len(mesh.facets[n])} facets") for n, c in colours.items()
    ]
    handles.append(Patch(facecolor=_PLANE, edgecolor="0.3", label="no film (symmetry)"))
    for name, (colour, marker) in _MARKS.items():
        label = f"{name}: {len(mesh.node_sets[name])} nodes"
        handles.append(Line2D([], [], color=colour, marker=marker, linestyle="none", label=label))
    figure.legend(handles=handles, loc="outside right upper", frameon=False)
    figure.suptitle(f"{title}: {mesh.n_elements} hex8, {mesh.n_nodes} nodes")
    return figure


def _outside(ax: Axes, mesh: Mesh, colours: dict[str, str]) -> None:
    """Free facets that look towards the viewer, the farthest first."""
    outer = boundary_facets(mesh.hexes)
    owner = {tuple(key): name for name, facets in mesh.facets.items() for key in np.sort(facets, axis=1).tolist()}
    x = mesh.nodes[outer]
    towards = np.cross(_VIEW[0], _VIEW[1])
    normal = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
    seen = np.flatnonzero(normal @ towards > 0.0)
    seen = seen[np.argsort(x[seen].mean(axis=1) @ towards)]
    fill = [colours.get(owner.get(tuple(sorted(facet)), ""), _PLANE) for facet in outer[seen].tolist()]
    ax.add_collection(PolyCollection(list(x[seen] @ _VIEW.T), facecolors=fill, edgecolors="0.3", linewidths=0.2))
    for name in ("bottom", "top"):
        colour, marker = _MARKS[name]
        where = mesh.nodes[mesh.node_sets[name]] @ _VIEW.T
        ax.plot(where[:, 0], where[:, 1], color=colour, marker=marker, markersize=2.0, linestyle="none")
    _finish(ax, "free faces")
    ax.set_axis_off()


def _face(ax: Axes, mesh: Mesh) -> None:
    """The face with its elements; nodes of the sets that lie on it are marked."""
    chosen = np.zeros(mesh.n_nodes, dtype=bool)
    chosen[mesh.node_sets["face"]] = True
    quads = facets_within(mesh.hexes, chosen)
    ax.add_collection(PolyCollection(list(mesh.nodes[quads][:, :, :2]), facecolors="white", edgecolors="0.4", linewidths=0.3))
    for name in ("x0", "z0", "bottom", "top"):
        colour, marker = _MARKS[name]
        ids = mesh.node_sets[name]
        ids = ids[chosen[ids]]
        ax.plot(mesh.nodes[ids, 0], mesh.nodes[ids, 1], color=colour, marker=marker, markersize=3.0, linestyle="none")
    _finish(ax, "face")
    ax.set_xlabel("x in mm")
    ax.set_ylabel("y in mm")


def _finish(ax: Axes, title: str) -> None:
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.margins(0.03)
    ax.set_title(title)
