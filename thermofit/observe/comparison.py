"""How a prediction is compared with an observation: channels, weights, and measures that rigid-body motion cannot reach.

A comparison is a linear map from the error field e = prediction - observation (n_t, n_s, n_c) to the whitened residual
r = sqrt(W) e of the objective (2.24), (2.27), together with the correlation that the map itself puts into the noise of r.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from thermofit.core.errors import DataError, StudyError
from thermofit.observe.observation import FieldObservation
from thermofit.observe.stencils import Stencil, differences

NoiseOperator = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Comparison:
    """`residual(error)` (n,) of an error field, `noise` applies the correlation of the residual's noise to (n, k), or None if white.

    `rows` (n, 3) names time, point and component of every residual entry; `sigma` (n,) and `weight` (n,) (1/unit^2) belong to it;
    `unit` is that of the compared quantity.
    """

    channel: str
    residual: Callable[[np.ndarray], np.ndarray]
    noise: NoiseOperator | None
    rows: np.ndarray
    sigma: np.ndarray
    weight: np.ndarray
    unit: str
    along: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    """Derivative (n,) of the residual at an error field in the direction of another one; None: the residual is linear."""
    field: str = ""
    """The observed field that it compares; empty: the one that the channel says."""
    several: Callable[[np.ndarray], np.ndarray] | None = None
    """What is faster than a linear residual of one error field after the other: residuals (n, m) of m of them."""

    @property
    def n(self) -> int:
        """Number of compared values."""
        return len(self.sigma)

    @property
    def spread(self) -> np.ndarray:
        """Standard deviation (n,) of the residual that the noise gives: one where the weight is 1/sigma^2."""
        return np.asarray(np.sqrt(self.weight) * self.sigma)

    def slope(self, error: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Derivative (n,) of the residual at `error` in the direction of the field `slope`."""
        return self.residual(slope) if self.along is None else self.along(error, slope)

    def slopes(self, error: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """The same (n, m) in the directions of m fields (n_t, n_s, n_c, m)."""
        if self.along is None:
            return self.columns(slopes)
        return _side_by_side(lambda slope: self.slope(error, slope), self.n, slopes)

    def columns(self, fields: np.ndarray) -> np.ndarray:
        """The residuals (n, m) of error fields (n_t, n_s, n_c, m)."""
        return _side_by_side(self.residual, self.n, fields) if self.several is None else self.several(fields)

    def scaled(self, factor: float) -> Comparison:
        """The same with all weights times a factor."""
        root, along = float(np.sqrt(factor)), self.along
        return replace(
            self,
            residual=lambda e: root * self.residual(e),
            weight=factor * self.weight,
            along=None if along is None else lambda e, s: root * along(e, s),
            several=lambda fields: root * self.columns(fields),
        )

    def blurred(self, columns: np.ndarray) -> Comparison:
        """The same with noise of what is prescribed beside that of what is measured: `columns` (n, k) are the residuals that k independent
        errors of unit variance make. The residual is whitened by (1 + columns columns^T)^(-1/2)."""
        u, s, _ = np.linalg.svd(columns, full_matrices=False)
        u, s = u[:, s > 1e-3], s[s > 1e-3]
        shrunk, along, noise = 1.0 - 1.0 / np.sqrt(1.0 + s**2), self.along, self.noise

        def along_modes(r: np.ndarray, size: np.ndarray) -> np.ndarray:
            return np.asarray(u @ ((u.T @ r).T * size).T)

        def white(r: np.ndarray) -> np.ndarray:
            return np.asarray(r - along_modes(r, shrunk))

        def correlated(v: np.ndarray) -> np.ndarray:
            assert noise is not None
            w = white(v)
            return white(noise(w) + along_modes(w, s**2))

        return replace(
            self,
            residual=lambda e: white(self.residual(e)),
            noise=None if noise is None else correlated,
            along=None if along is None else lambda e, direction: white(along(e, direction)),
            several=lambda fields: white(self.columns(fields)),
        )


@dataclass(frozen=True)
class RelativeScheme:
    """Which relative displacements: scheme, components xx, yy, xy, yx, distance of the neighbour in mm (None: the next point), and the
    largest one allowed (None: any)."""

    scheme: str = "rigid-body"
    components: tuple[str, ...] = ("xx", "yy")
    distance: float | None = None
    reach: float | None = None


Weight = float | str | tuple[float, float]


def weights(choice: Weight, value: np.ndarray, sigma: np.ndarray, component: np.ndarray) -> np.ndarray:
    """W of every entry: "sigma" or "balanced" 1/sigma^2, "value" (2.25), "max" (2.26), a number, or one number for each component.

    "value" is bounded at the noise level, where it would divide by zero.
    """
    if choice in ("sigma", "balanced"):
        return 1.0 / sigma**2
    if choice == "value":
        return 1.0 / np.maximum(np.abs(value), sigma) ** 2
    if choice == "max":
        largest = np.array([np.max(np.abs(value[component == c]), initial=0.0) for c in range(int(component.max(initial=0)) + 1)])
        return 1.0 / np.maximum(largest[component], np.finfo(float).tiny) ** 2
    if isinstance(choice, tuple):
        return np.asarray(choice)[component]
    if isinstance(choice, str):
        raise StudyError(f"weight '{choice}' is not known; expected sigma, balanced, value, max or numbers")
    return np.full(len(value), float(choice))


def plain(observation: FieldObservation, choice: Weight = "sigma") -> Comparison:
    """The field itself (2.8), (2.20)."""
    rows = _rows(observation.mask, observation.value.shape[2])
    take = tuple(rows.T)
    sigma = observation.sigma[take]
    w = weights(choice, observation.value[take], sigma, rows[:, 2])
    root = np.sqrt(w)
    return Comparison(observation.name, lambda e: root * e[take], None, rows, sigma, w, observation.unit)


def rigid_free(observation: FieldObservation, choice: Weight = "sigma", *, scale: bool = False) -> Comparison:
    """Relative displacements of all points at once: at every time the best small rigid motion is taken out of the error.

    What is left is what no translation and no small in-plane rotation of the deformed
    specimen can explain. The generators are 1, 1 and the rotation of the current position X + u; with `scale` that position too.
    """
    rows = _rows(observation.mask, 2)
    take = tuple(rows.T)
    sigma = observation.sigma[take]
    root = np.sqrt(weights(choice, observation.value[take], sigma, rows[:, 2]))
    bounds, place = np.searchsorted(rows[:, 0], np.arange(len(observation.time) + 1)), observation.place
    bases = []
    for n in range(len(observation.time)):
        part = slice(bounds[n], bounds[n + 1])
        if bounds[n + 1] == bounds[n]:
            bases.append(np.zeros((0, 3)))
            continue
        if bounds[n + 1] - bounds[n] < 6:
            raise DataError(
                f"{observation.name}: fewer than 3 points are measured at {observation.time[n]:g} s; leave this stage out of the window"
            )
        current = place[n, rows[part, 1]] + observation.value[n, rows[part, 1]]
        x_row = rows[part, 2] == 0
        generators = np.stack([x_row * 1.0, ~x_row * 1.0, np.where(x_row, -current[:, 1], current[:, 0])], axis=1)
        if scale:
            generators = np.column_stack([generators, np.where(x_row, current[:, 0], current[:, 1])])
        bases.append(np.linalg.qr(root[part, None] * generators)[0])

    def residual(error: np.ndarray) -> np.ndarray:
        r = root * error[take]
        for n, basis in enumerate(bases):
            part = slice(bounds[n], bounds[n + 1])
            r[part] -= basis @ (basis.T @ r[part])
        return r

    return Comparison("du", residual, None, rows, sigma, root**2, observation.unit)


def neighbour_differences(observation: FieldObservation, scheme: RelativeScheme, choice: Weight = "sigma") -> Comparison:
    """Differences to the next point in x or y, (2.11) to (2.14); scheme "gradient" divides by the distance, (2.15) to (2.17).

    A difference counts where all its points are measured. Its noise is correlated with that of its neighbours; `noise` applies it.
    """
    gradient = scheme.scheme == "gradient"
    stencil = differences(observation.xy, scheme.components, gradient=gradient, distance=scheme.distance, reach=scheme.reach)
    return of_stencil(observation, stencil, "du", choice)


def of_stencil(observation: FieldObservation, stencil: Stencil, channel: str, choice: Weight) -> Comparison:
    """Comparison of linear functionals of the displacements. DataError where none has all its points measured."""
    used = stencil.measured(observation.mask)
    if not used.any():
        raise DataError(
            f"{channel}: no two of the {len(observation.xy)} points are measured neighbours within the window; widen it, or the reach or "
            "radius of the scheme, or use du with scheme rigid-body"
        )
    time, number = np.nonzero(used)
    value = stencil.at(filled(observation, observation.value))[time, number]
    sigma, spread = functional_noise(observation, csr_array(stencil.matrix[number]), time)
    kind = stencil.component if isinstance(choice, tuple) else stencil.kind
    w = weights(choice, value, sigma, kind[number])
    root = np.sqrt(w)

    turned = _turned_about_nodes(observation)

    def residual(error: np.ndarray) -> np.ndarray:
        return np.asarray(root * stencil.at(turned(filled(observation, error)))[time, number])

    rows = np.stack([time, stencil.point[number], stencil.component[number]], axis=1)
    return Comparison(channel, residual, lambda v: spread @ (spread.T @ v), rows, sigma, w, stencil.unit)


def _turned_about_nodes(observation: FieldObservation) -> Callable[[np.ndarray], np.ndarray]:
    """What makes of an error field (n_t, n_s, 2) of means over patches one that a small rotation reaches as it would at the nodes.

    A rotation omega moves the mean of a patch whose centre is at d from its node by omega (-d_y, d_x) more than the node; differences
    between nodes would see that. omega is that of the best rigid motion of the error at every time.
    """
    if observation.moments is None:
        return lambda error: error
    away, mask = observation.moments[:, :, :2], observation.mask
    number = np.maximum(mask.sum(axis=1), 1)[:, None, None]
    place = np.where(mask[:, :, None], observation.place, 0.0)
    arm = np.where(mask[:, :, None], place - place.sum(axis=1, keepdims=True) / number, 0.0)
    inertia = np.maximum((arm**2).sum(axis=(1, 2)), np.finfo(float).tiny)

    def turned(error: np.ndarray) -> np.ndarray:
        omega = (arm[:, :, 0] * error[:, :, 1] - arm[:, :, 1] * error[:, :, 0]).sum(axis=1) / inertia
        shift = omega[:, None, None] * np.stack([-away[:, :, 1], away[:, :, 0]], axis=-1)
        return np.asarray(error - np.where(mask[:, :, None], shift, 0.0))

    return turned


def filled(observation: FieldObservation, field: np.ndarray) -> np.ndarray:
    """A field (n_t, n_s, n_c) with zeros where nothing is measured."""
    return np.where(observation.mask[:, :, None], field, 0.0)


def functional_noise(observation: FieldObservation, matrix: csr_array, time: np.ndarray) -> tuple[np.ndarray, csr_array]:
    """Sigma (n,) of functionals (n, 2 n_s) taken at times (n,), and the map (n, n_t 2 n_s) with unit rows from unit noise of all
    displacements to theirs."""
    width = matrix.shape[1]
    entries = matrix.tocoo()
    row, column = entries.coords
    noise = filled(observation, observation.sigma).reshape(len(observation.time), width)
    value = entries.data * noise[time[row], column]
    sigma = np.sqrt(np.bincount(row, value**2, minlength=matrix.shape[0]))
    shape = (matrix.shape[0], len(observation.time) * width)
    return sigma, csr_array((value / sigma[row], (row, time[row] * width + column)), shape=shape)


def relative_displacements(observation: FieldObservation, scheme: RelativeScheme, choice: Weight = "sigma") -> Comparison:
    """Channel du by the scheme chosen (2.10)."""
    if scheme.scheme in ("rigid-body", "similarity"):
        return rigid_free(observation, choice, scale=scheme.scheme == "similarity")
    return neighbour_differences(observation, scheme, choice)


def temperature_change(observation: FieldObservation, reference: np.ndarray, choice: Weight = "sigma") -> Comparison:
    """Channel dtheta (2.21) to (2.23): change against the mean over the reference times; `reference` (n_t,) is True there.

    The noise of the reference is common to all times of a point; `noise` applies that correlation.
    """
    if not reference.any():
        raise DataError(
            "dtheta: no frame lies before loading, so that there is no reference; give evaluation.reference_time or use channel theta"
        )
    based = observation.mask[reference].all(axis=0)
    mask = observation.mask & based & ~reference[:, None]
    if not mask.any():
        raise DataError("dtheta: no point is measured both at the reference times and later; check the window and the camera")
    rows = _rows(mask, 1)
    take = tuple(rows.T)
    filled = np.where(observation.mask[:, :, None], observation.sigma, 0.0)
    variance_reference = (filled[reference] ** 2).sum(axis=0)[:, 0] / reference.sum() ** 2
    own = observation.sigma[take]
    total = np.sqrt(own**2 + variance_reference[rows[:, 1]])
    base = np.where(observation.mask[:, :, None], observation.value, 0.0)[reference].mean(axis=0)
    value = observation.value[take] - base[rows[:, 1], 0]
    w = weights(choice, value, total, rows[:, 2])
    root = np.sqrt(w)

    def residual(error: np.ndarray) -> np.ndarray:
        shift = np.where(observation.mask[:, :, None], error, 0.0)[reference].mean(axis=0)
        return root * (error[take] - shift[rows[:, 1], 0])

    common = csr_array((np.sqrt(variance_reference[rows[:, 1]]) / total, (np.arange(len(rows)), rows[:, 1])), shape=(len(rows), len(based)))

    def noise(v: np.ndarray) -> np.ndarray:
        return np.asarray(((own / total) ** 2)[:, None] * v + common @ (common.T @ v))

    return Comparison("dtheta", residual, noise, rows, total, w, observation.unit)


def _side_by_side(residual: Callable[[np.ndarray], np.ndarray], n: int, fields: np.ndarray) -> np.ndarray:
    """The residuals (n, m) of fields (n_t, n_s, n_c, m), each contiguous."""
    out = np.empty((n, fields.shape[-1]), order="F")
    for k in range(fields.shape[-1]):
        out[:, k] = residual(fields[..., k])
    return out


def _rows(mask: np.ndarray, n_components: int) -> np.ndarray:
    t, s = np.nonzero(mask)
    c = np.arange(n_components)
    return np.stack([np.repeat(t, n_components), np.repeat(s, n_components), np.tile(c, len(t))], axis=1)
