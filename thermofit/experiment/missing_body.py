"""Missing terms of a body: heat sources and what comes through its surface by the conduction of the fitted run, displacements as the
cameras would show them, offsets of the infrared camera and errors of its clock, and the apparent strain of cameras that come nearer or
whose scale drifts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from thermofit.body.body import Body, about_middle, thermal_geometry
from thermofit.body.heat.conduction import GAMMA, HeatStep, at_constant_stress, ends_of_stages, heat_step
from thermofit.body.heat.effects import INSTANTS
from thermofit.body.heat.equation import at_points
from thermofit.body.heat.films import conditions_of
from thermofit.body.heat.one_way import heat_run
from thermofit.body.heat.sources import nodal_heat
from thermofit.body.sensitivity.conduction_rates import through_stages
from thermofit.body.solve.history import History
from thermofit.core.parameters import Parameters, param
from thermofit.effects.film_exchange import FILM_UNIT
from thermofit.experiment.forward import MechanicalRun
from thermofit.experiment.free_expansion import CrossSections, Expansion, Flow, FlowOfRun, sections_of
from thermofit.experiment.instruments import Instruments, carried
from thermofit.experiment.known_motion import freely_expanding, keeping_points
from thermofit.experiment.missing import KINDS, Grid, place_hats, spot_values, time_hats
from thermofit.law.page import law_of
from thermofit.observe.observation import FieldObservation

FIELDS = {"theta": "heat", "u": "displacement"}
FREE = "air"
"""How names of facet sets begin that the jaws leave free."""
GRIPPED = "clamp"
"""How names of facet sets begin that the jaws hold."""
OF_CAMERAS = {"theta": ("offset", "gradient", "clock"), "u": ("strain", "scale")}
"""What a camera may add to all of its image: as much everywhere, growing along the load, or what comes of another time; to every length, or
to every displacement."""
OF_SURFACE = ("flux", "film", "jaws", "jaw_upper", "jaw_lower")
"""What may come through the surface, and temperatures show: through all that is free, by as much everywhere or by a film that changes, or
from jaws whose temperature changes."""
HEATING = ("heat", *OF_SURFACE)
"""What runs through the heat equation."""
SIDES = {"all": 0.0, "upper": 1.0, "lower": -1.0}
"""The sign of y of the jaw that changes; 0: both."""
BETWEEN = 2.0
"""Usual distances of frames between two knots of a history of the jaws at most."""
SMALL = 1e-4
"""Part of a parameter, or of its usual size where that is larger, by which it is moved for a difference quotient."""
LEAST = 0.1
"""Part of the height of an element below which a spot is a point for it."""
PER_MILLE = 1e-3
"""Apparent strain or error of the scale of a unit coefficient, mm/m, and offset of a camera per length, mK/mm."""


@dataclass(frozen=True)
class BodyMissing:
    """What the run of `instruments` lacks; `whole` is the coupled run behind it, which is made once at given parameters and kept."""

    instruments: Instruments
    whole: MechanicalRun
    kept: dict[tuple[tuple[str, float], ...], History]
    flows: dict[tuple[tuple[str, float], ...], Flow] = field(default_factory=dict)
    """How much further the specimen flows as it warms, by parameters, as `kept`."""

    @property
    def kinds(self) -> Mapping[str, str]:
        """Kind of the missing term by observed field."""
        return {field: kind for field, kind in FIELDS.items() if field in self.instruments.observations}

    @property
    def of_instruments(self) -> Mapping[str, tuple[str, ...]]:
        """Kinds of what a camera may add to an observed field."""
        return {field: kinds for field, kinds in OF_CAMERAS.items() if field in self.instruments.observations}

    @property
    def of_surface(self) -> Mapping[str, tuple[str, ...]]:
        """Kinds of what may come through the free surface or from the jaws, where the mesh says which these are."""
        sets = [name for name, facets in self.body.mesh.facets.items() if facets.size]
        there = {alike: any(name.startswith(begin) for name in sets) for alike, begin in (("surface", FREE), ("jaws", GRIPPED))}
        found = tuple(kind for kind in OF_SURFACE if there[KINDS[kind].alike])
        return {"theta": found} if found and "theta" in self.instruments.observations else {}

    @property
    def records(self) -> tuple[()]:
        """None: a term has a place on the specimen."""
        return ()

    @property
    def offsets(self) -> np.ndarray:
        """None (0,)."""
        return np.zeros(0)

    @property
    def of_yield(self) -> None:
        """Stresses are not what cameras show."""

    @property
    def folded(self) -> bool:
        """True where the model is one half in x: a source stands on both sides."""
        return bool(self.body.mesh.nodes[:, 0].min() > -1e-9)

    @property
    def body(self) -> Body:
        """Body of the run."""
        return self.whole.body

    def grid(self, kind: str, counts: tuple[int, int, int]) -> Grid:
        """Hats over all that is observed; a heat source of a folded model is one of |x|. What is the same everywhere has hats as dense in
        time as it is observed. Jaws have no fewer of them where frames are rare: they may do as much there as elsewhere."""
        field = _field_of(kind)
        seen = self.instruments.observations[field]
        if KINDS[kind].alike:
            time = np.quantile(seen.time, np.linspace(0.0, 1.0, min(counts[0], len(seen.time))))
            if KINDS[kind].alike == "jaws":
                time = closer(time, BETWEEN * float(np.median(np.diff(time))))
            return Grid(time, np.zeros(len(time), dtype=int), np.zeros(1), np.zeros(1))
        used = seen.mask.any(axis=0)
        low, high = seen.xy[used].min(axis=0), seen.xy[used].max(axis=0)
        if kind == "heat" and self.folded:
            low[0] = 0.0
        time = np.linspace(seen.time[0], seen.time[-1], counts[0])
        x, y = (np.linspace(low[k], high[k], counts[2 - k]) for k in (0, 1))
        return Grid(time, np.zeros(counts[0], dtype=int), x, y, 2 if kind == "displacement" else 1)

    def everywhere(self, counts: tuple[int, int]) -> Grid:
        """Hats of a heat source over the whole specimen, as dense in time as it is observed; beyond what is observed one at either end,
        which stands for the jaws, and one across."""
        seen = self.instruments.observations["theta"]
        observed = self.grid("heat", (*counts, 1))
        ends = self.body.mesh.nodes[:, 1]
        time = np.quantile(seen.time, np.linspace(0.0, 1.0, counts[0]))
        return replace(observed, time=time, x=np.zeros(1), y=np.array([ends.min(), *observed.y, ends.max()]))

    def spot(self, count: int) -> Grid:
        """A spot of heat in the middle of what is observed; it is no narrower than LEAST of the highest element, within which no spread is
        seen."""
        grid, (low, high) = self.everywhere((count, 1)), self._heights()
        return replace(grid, y=np.array([0.5 * (grid.y[0] + grid.y[-1])]), spread=LEAST * float(np.max(high - low)))

    def answers(
        self, kind: str, parameters: Parameters, grid: Grid, chosen: np.ndarray, amount: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        """Change (n_t, n_s, n_c, m) of observed fields by unit coefficients of the chosen hats; mW/mm^3, mW/mm^2 of current area,
        W/(m^2 K), K of the jaws, mm, K, mK/mm, s and mm/m; m = 1 by an `amount` (m,) of each. The field that shows the kind comes first. A
        pixel of the infrared camera is given to the point that the displacement cameras say is there, and what is warmer expands."""
        if kind in HEATING:
            return self._warmed(parameters, self.history(parameters, points=kind == "film"), kind, grid, chosen, amount)
        found = self._added(kind, parameters, grid, chosen)
        return found if amount is None else {field: (value @ amount)[..., None] for field, value in found.items()}

    def _added(self, kind: str, parameters: Parameters, grid: Grid, chosen: np.ndarray) -> dict[str, np.ndarray]:
        """What instruments add by unit coefficients, as `answers`."""
        field = _field_of(kind)
        if kind == "clock":
            return {field: self._late(parameters, grid, chosen)}
        if kind not in ("strain", "scale", "gradient"):
            return {field: _shown_directly(grid, self.instruments.observations[field], chosen)}
        return {field: self._magnified(parameters, kind, grid, chosen), **self._carried(parameters, kind, grid, chosen)}

    def slopes(
        self, kind: str, parameters: Parameters, grid: Grid, chosen: np.ndarray, amount: np.ndarray, names: Sequence[str]
    ) -> Mapping[str, np.ndarray]:
        """Derivatives (n_t, n_s, n_c, n) along the named parameters of what heats with these coefficients (m,) add to temperatures and
        displacements, on the motion of the run at `parameters` and with its flow; none of a kind that does not run through the heat
        equation. What a film lets out goes with the temperatures of a run: those of a heat run on that motion are told for each of them.
        NumericsError where the run fails."""
        if kind not in HEATING:
            return {}
        history = self.history(parameters, points=kind == "film")
        first = self._warmed(parameters, history, kind, grid, chosen, amount)
        flow = self.flow(parameters) if grid.places == 1 else None
        found = {field: [np.zeros((*value.shape[:3], 0))] for field, value in first.items()}
        problem = freely_expanding(self.whole, history) if kind == "film" and names else None
        apart = 0.0 if problem is None else history.theta - heat_run(problem, parameters)
        for name in names:
            step = SMALL * max(abs(parameters[name]), param(name).scale)
            moved = parameters.replace(**{name: parameters[name] + step})
            there = history if problem is None else replace(history, theta=heat_run(problem, moved) + apart)
            for seen, value in self._warmed(moved, there, kind, grid, chosen, amount, flow).items():
                found[seen].append((value - first[seen]) / step)
        return {field: np.concatenate(columns, axis=-1) for field, columns in found.items()}

    def volumes(self, grid: Grid) -> np.ndarray | None:
        """Volume (n_places,) mm^3 of the whole specimen under each hat."""
        weights = self._places(grid)
        return np.asarray(self.body.symmetry * np.einsum("eq,eqn->n", self.body.data.volume, weights))

    def _places(self, grid: Grid) -> np.ndarray:
        """Values (n_el, 8, n_places) of the hats at the points of integration; of a spot those with which its power and its first moment in
        every element are exact, for it may be smaller than that. Of one that travels (n_el, 8, n_k), one place for every time."""
        x, y = self.body.points
        if not grid.spread:
            return place_hats(grid, np.abs(x) if self.folded else x, y)
        low, high = self._heights()
        return spot_values(grid, low, high, y)

    def _heights(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest height (n_el,) mm of every element, from the middle of the body."""
        y = about_middle(self.body)[1][self.body.mesh.hexes]
        return y.min(axis=1), y.max(axis=1)

    def history(self, parameters: Parameters, points: bool = False) -> History:
        """The run at the parameters, of the body itself and with its points where a heat run on its motion needs them."""
        key = _key(parameters)
        if key not in self.kept or (points and not self.kept[key].points):
            self.kept.clear()
            run, flow = keeping_points(self.whole) if points else self.instruments.run, self._flow_of(parameters)
            self.kept[key] = run(parameters) if flow is None else run(parameters, flow.watch)
            self._keep(key, flow)
        return self.kept[key]

    def flow(self, parameters: Parameters) -> Flow | None:
        """How much further the specimen flows at the parameters as it warms; None of one that does not expand freely, or is not seen to.
        NumericsError where a run fails."""
        key = _key(parameters)
        found = None if key in self.flows else self._flow_of(parameters)
        if found is not None:
            self.whole(parameters, found.watch)
            self._keep(key, found)
        return self.flows.get(key)

    def _flow_of(self, parameters: Parameters) -> FlowOfRun | None:
        """What collects the flow of a run of the whole at the parameters."""
        sections = self._expands()
        if sections is None:
            return None
        return FlowOfRun(sections, self.body.mesh.nodes, parameters["alpha_exp"], len(self.whole.time))

    def _keep(self, key: tuple[tuple[str, float], ...], found: FlowOfRun | None) -> None:
        """Keep what a run has collected, and nothing else."""
        self.flows.clear()
        if found is not None:
            self.flows[key] = found.flow

    def on(self, history: History, parameters: Parameters) -> BodyMissing:
        """The same, which has run at these parameters."""
        return replace(self, kept={_key(parameters): history})

    def _carried(self, parameters: Parameters, kind: str, grid: Grid, chosen: np.ndarray) -> dict[str, np.ndarray]:
        """Change (n_t, n_s, 1, m) of temperatures, which are given to other points where displacement cameras add something."""
        if kind not in OF_CAMERAS["u"] or "theta" not in self.instruments.observations:
            return {}
        seen, view = self.instruments.observations["theta"], self.instruments.view("theta", self.history(parameters))
        length = view.motion if kind == "scale" else view.scene.position
        shown = view.taken(carried(view.field, view.scene, PER_MILLE * length))
        return {"theta": seen.averaged(shown[..., None] * _over_time(grid, seen, chosen)[:, None, None, :])}

    def _magnified(self, parameters: Parameters, kind: str, grid: Grid, chosen: np.ndarray) -> np.ndarray:
        """Displacements (n_t, n_s, 2, m) that an apparent strain of 1 mm/m adds, e (x + u) as of effect `dic_out_of_plane`, or an error of
        the scale of as much, e u as of `dic_scale`; temperatures (n_t, n_s, 1, m) that 1 mK/mm adds, g (y + v - y_0), y_0 the knot of
        the grid in y. All of the run, for noise of measured displacements would be taken for them."""
        field = _field_of(kind)
        seen, view = self.instruments.observations[field], self.instruments.view(field, self.history(parameters))
        length = view.field if kind == "scale" else view.scene.position[view.index]
        if kind == "gradient":
            length = length[:, :, 1:] - grid.y[0]
        return seen.averaged(PER_MILLE * length[..., None] * _over_time(grid, seen, chosen)[:, None, None, :])

    def _late(self, parameters: Parameters, grid: Grid, chosen: np.ndarray) -> np.ndarray:
        """Temperatures (n_t, n_s, 1, m) that frames add which show the specimen 1 s later than they say: to first order d theta/dt."""
        history = self.history(parameters)
        seen, view = self.instruments.observations["theta"], self.instruments.view("theta", history)
        rate = np.gradient(view.field, history.time, axis=0)
        shown = self.instruments.shown_along("theta", view, rate, parameters)
        return seen.averaged(shown[..., None] * _over_time(grid, seen, chosen)[:, None, None, :])

    def _warmed(
        self,
        parameters: Parameters,
        history: History,
        kind: str,
        grid: Grid,
        chosen: np.ndarray,
        amount: np.ndarray | None = None,
        flow: Flow | None = None,
    ) -> dict[str, np.ndarray]:
        """Change (n_t, n_s, n_c, m) of temperatures, and of the displacements of what expands freely, by unit coefficients on a known
        motion; m = 1 by all with an `amount` (m,). Where a term of many places is, temperatures alone tell. `flow`: that of other
        parameters, in the stead of these."""
        columns = len(chosen) if amount is None else 1
        loads = None if kind in OF_SURFACE else nodal_heat(self.body, self._places(grid))
        sections = self._expands() if grid.places == 1 else None
        flow = None if sections is None else flow or self.flow(parameters)
        expands = None if sections is None or flow is None else Expansion(sections, flow, parameters["alpha_exp"])
        at = {"theta": np.arange(len(history.time)), **({} if expands is None else {"u": self.instruments.samplers["u"].index})}
        full = {name: np.zeros((len(n), *self.instruments.observations[name].value.shape[1:], columns)) for name, n in at.items()}
        for n, theta in self._marched(parameters, history, grid, kind if loads is None else loads, chosen, amount):
            full["theta"][n] = self.instruments.samplers["theta"].temperature_rates(theta)
            seen = expands is not None and bool((at["u"] == n).any())
            if expands is not None and (seen or expands.last[n]):
                moved = expands.at(n, self.body.mesh.nodes + history.u[n], theta)
            if seen:
                shown = self.instruments.samplers["u"].operator.displacement(moved.transpose(2, 0, 1))
                full["u"][at["u"] == n] = shown.transpose(1, 2, 0)
        return {name: self._through_camera(name, parameters, history, value) for name, value in full.items()}

    def _through_camera(self, name: str, parameters: Parameters, history: History, full: np.ndarray) -> np.ndarray:
        """What is observed (n_t, n_s, n_c, m) of changes of temperatures (n_steps, n_s, 1, m) or displacements (n_t, n_s, 2, m)."""
        seen = self.instruments.observations[name]
        if not self.instruments.changes(name, parameters):
            return seen.averaged(full[self.instruments.samplers[name].index] if name == "theta" else full)
        view, flat = self.instruments.view(name, history), full[:, :, 0] if name == "theta" else full
        shown = [self.instruments.shown_along(name, view, flat[..., k], parameters) for k in range(full.shape[-1])]
        return seen.averaged(np.stack(shown, axis=-1))

    def _expands(self) -> CrossSections | None:
        """The sections of a specimen that is pulled by a force, and expands freely as it warms, where displacements are observed."""
        free = "u" in self.instruments.observations and self.whole.loading.control == "force"
        return sections_of(self.body) if free else None

    def _marched(
        self,
        parameters: Parameters,
        history: History,
        grid: Grid,
        loads: np.ndarray | str,
        chosen: np.ndarray,
        amount: np.ndarray | None = None,
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Temperatures (n_np, m) at every time by unit sources, or (n_np, 1) by an `amount` (m,) of each: steps of the run with the factors
        of its own heat equation. `loads` (n_np, n_places): mW of each place, (n_np, n_k) of one that travels; or of which kind of
        `OF_SURFACE` they are. What a film lets out goes with the temperatures of the run and those that its changes `level` add."""
        k, place = np.unravel_index(chosen, (len(grid.time), grid.places))
        place = place if grid.along is None else k
        of_jaws = isinstance(loads, str) and KINDS[loads].alike == "jaws"
        strength = [
            s[:, k] for s in (_at_ends(grid, history.time, self.whole.settings.heat_scheme) if of_jaws else (_means(grid, history.time),))
        ]
        state = np.zeros((self.body.mesh.n_nodes, len(chosen) if amount is None else 1))
        level = np.zeros(len(history.time) - 1) if grid.level is None else _means(grid, history.time) @ grid.level
        added = np.zeros(self.body.mesh.n_nodes)
        for n, (step, films) in enumerate(self._steps(parameters, history)):
            active = np.flatnonzero(np.any([s[: n + 1].any(axis=0) for s in strength], axis=0))
            if isinstance(loads, str) and loads == "film":
                theta = 0.5 * (history.theta[n] + history.theta[n + 1])
                through, added = self._of_film(step, films, theta, added, float(level[n]))
            if active.size:
                if isinstance(loads, str):
                    mine = (through if loads == "film" else self._through(loads, step, films))[:, None]
                else:
                    mine = loads[:, place[active]]
                heat = [step.length * mine * s[n, active] for s in strength]
                if amount is not None:
                    heat, active = [(h @ amount[active])[:, None] for h in heat], np.zeros(1, dtype=int)
                gamma = 1.0 if len(step.stages) == 1 else GAMMA
                supplies = [gamma * heat[min(stage, len(heat) - 1)] for stage in range(len(step.stages))]
                state[:, active] = through_stages(self.body, step, np.ascontiguousarray(state[:, active]), supplies)
            yield n + 1, state

    def _through(self, kind: str, step: HeatStep, films: Mapping[str, np.ndarray]) -> np.ndarray:
        """Nodal power (n_np,) mW of a flux of 1 mW/mm^2 through the free surface, or of jaws that are 1 K warmer; `films`: area (n_np,)
        mm^2 of the nodes by facet set."""
        nothing, coefficient = np.zeros(self.body.mesh.n_nodes), step.conditions.films
        if KINDS[kind].alike != "jaws":
            return np.asarray(np.sum([nothing, *(own for name, own in films.items() if name.startswith(FREE))], axis=0))
        of_jaws = [FILM_UNIT * coefficient[name][0] * own for name, own in films.items() if name.startswith(GRIPPED)]
        side = SIDES[KINDS[kind].which] * about_middle(self.body)[1]
        return np.asarray(np.sum([nothing, *of_jaws], axis=0) * (side >= 0.0))

    def _of_film(
        self, step: HeatStep, films: Mapping[str, np.ndarray], theta: np.ndarray, added: np.ndarray, level: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Nodal power (n_np,) mW of a film that is 1 W/(m^2 K) more,

            -int N (theta + theta_a - theta_M) dA,

        and the temperatures theta_a (n_np,) K at the end of the step that a change of the film by `level` W/(m^2 K) makes from those
        `added` at its start; `theta` (n_np,) K: those of the run in the middle of the step, `films`: as `_through`."""
        after = added
        for _ in range(2):  # the mean of both ends, of which the second is found with the first
            inside = theta + 0.5 * (added + after)
            of_air = [FILM_UNIT * area * (inside - _medium(step, name)) for name, area in films.items() if name.startswith(FREE)]
            through = -np.asarray(np.sum([np.zeros(len(theta)), *of_air], axis=0))
            if not level and not added.any():
                return through, added
            supply = (1.0 if len(step.stages) == 1 else GAMMA) * step.length * level * through
            after = through_stages(self.body, step, added, [supply.copy() for _ in step.stages])
        return through, after

    def _steps(self, parameters: Parameters, history: History) -> Iterator[tuple[HeatStep, Mapping[str, np.ndarray]]]:
        """The steps of the heat equation on the known motion, and the area (n_np,) mm^2 of the nodes by facet set; the capacity is that of
        constant stress, because the body expands freely."""
        settings = self.whole.settings
        law = law_of(parameters, settings.model, closed_form=settings.closed_form, plastic=settings.plastic)
        conditions = at_constant_stress(conditions_of(self.body, parameters, settings.films), law)
        first, nothing = float(history.time[0]), np.zeros(self.body.mesh.n_nodes)
        before = thermal_geometry(self.body, history.u[0])
        for n, dt in enumerate(np.diff(history.time)):
            after = thermal_geometry(self.body, history.u[n + 1])
            here = conditions.at(first, float(history.time[n]), history.theta[n])
            mean = before.mean_with(after)
            yield heat_step(self.body, mean, here, history.theta[n], nothing, (float(dt), settings.heat_scheme)), mean.film_area
            before = after

    def states(self, parameters: Parameters, grid: Grid) -> Mapping[str, np.ndarray]:
        """State variables (n_k, n_places) at the knots: means over the hats of temperature rise and axial strain with its rate, the load
        and its rate, and where and when it is."""
        history = self.history(parameters)
        weights = self._places(grid) * self.body.data.volume[:, :, None]
        total = np.maximum(weights.sum(axis=(0, 1)), 1e-12)
        rise, strain = [], []
        for theta, u in zip(history.theta, history.u, strict=True):
            stretch = 1.0 + np.einsum("eqa,ea->eq", self.body.data.gradient[:, :, :, 1], u[:, 1][self.body.mesh.hexes])
            rise.append(np.einsum("eq,eqn->n", at_points(self.body.data, theta - history.theta[0]), weights) / total)
            strain.append(np.einsum("eq,eqn->n", np.log(np.maximum(stretch, 1e-3)), weights) / total)
        rate = np.gradient(np.array(strain), history.time, axis=0)
        load = np.repeat((np.abs(history.force) / max(float(np.abs(history.force).max()), 1e-12))[:, None], grid.places, axis=1)
        found = {"temperature rise": np.array(rise), "strain": np.array(strain), "strain rate": rate, "load": load}
        out = {name: _at_knots(history.time, value, grid.time) for name, value in found.items()}
        x, y = np.tile(grid.x, len(grid.y)), np.repeat(grid.y, len(grid.x))
        return out | {"x": np.tile(x, (len(grid.time), 1)), "y": np.tile(y, (len(grid.time), 1))}


def _key(parameters: Parameters) -> tuple[tuple[str, float], ...]:
    """By what a run is kept."""
    return tuple(sorted(parameters.values.items()))


def _field_of(kind: str) -> str:
    """The observed field that shows a kind of term."""
    return next(f for f in FIELDS if kind in (FIELDS[f], *OF_CAMERAS[f], *(OF_SURFACE if f == "theta" else ())))


def _medium(step: HeatStep, name: str) -> np.ndarray | float:
    """Temperature K of the medium beyond the film of a facet set, by node (n_np,) where an effect changes it: its mean over the step."""
    medium, changes = step.conditions.films[name][1], {} if step.loads is None else step.loads.media
    return np.asarray(medium + changes[name].mean(axis=0)) if name in changes else medium


def _means(grid: Grid, time: np.ndarray) -> np.ndarray:
    """Means (n_steps, n_k) of the hats over the steps between times (n_t,)."""
    one = np.zeros(len(time) - 1, dtype=int)
    return np.asarray(sum(w * time_hats(grid, time[:-1] + part * np.diff(time), one) for w, part in INSTANTS))


def closer(knots: np.ndarray, most: float) -> np.ndarray:
    """Increasing knots (n,) with more between those that are farther apart than `most`, evenly."""
    parts = [np.linspace(a, b, max(int(np.ceil((b - a) / most)), 1), endpoint=False) for a, b in pairwise(knots)]
    return np.append(np.concatenate(parts), knots[-1])


def _at_ends(grid: Grid, time: np.ndarray, scheme: str) -> tuple[np.ndarray, ...]:
    """The hats (n_steps, n_k) at the ends of every stage of the steps between times (n_t,), where a run has the temperature of the jaws."""
    one = np.zeros(len(time) - 1, dtype=int)
    return tuple(time_hats(grid, time[:-1] + part * np.diff(time), one) for part in ends_of_stages(scheme))


def _at_knots(time: np.ndarray, value: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """A history (n_t, n) at the knots (n_k, n)."""
    return np.stack([np.interp(knots, time, column) for column in value.T], axis=1)


def _over_time(grid: Grid, seen: FieldObservation, chosen: np.ndarray) -> np.ndarray:
    """Values (n_t, m) of chosen hats over time alone at the observed times."""
    return time_hats(grid, seen.time, np.zeros(len(seen.time), dtype=int))[:, chosen]


def _shown_directly(grid: Grid, seen: FieldObservation, chosen: np.ndarray) -> np.ndarray:
    """The hats themselves (n_t, n_s, n_c, m) at the observed times and points."""
    k, place, component = np.unravel_index(chosen, (len(grid.time), grid.places, grid.components))
    in_time = time_hats(grid, seen.time, np.zeros(len(seen.time), dtype=int))[:, k]
    in_place = place_hats(grid, seen.xy[:, 0], seen.xy[:, 1])[:, place]
    out = np.zeros((*seen.value.shape, len(chosen)))
    for c in range(grid.components):
        own = np.flatnonzero(component == c)
        out[:, :, c, own] = in_time[:, None, own] * in_place[None, :, own]
    return seen.averaged(out)
