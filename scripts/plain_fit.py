"""A plain fit beside the loop: least squares of scipy with an integration of its own, on the samples that a run on coupons has read.

    python scripts/plain_fit.py RUN_DIR voce2 af1+af2 power+soft ...

Voce's law is always fitted; each further word is a sum of terms of the catalogue. Nothing of thermofit is imported. Small strains in true
strain and true stress: eps = ln(1 + e), sigma = s (1 + e), dsigma = E (deps - dp n), backward Euler of dp, Armstrong-Frederick
backstresses, heat c0 dT = M_y0 dp - c0 (T - T0) dt / tau. Printed are the rms error over the noise (sigma of a record: noise of the stress
and E times that of the strain, E of `identify-elastic`), the plain rms in MPa, and the slope of the first loading by regression.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
from pathlib import Path

import h5py
import numpy as np
from numba import njit
from scipy.optimize import least_squares

NAMES = ("E", "M_y0", "M_yinf", "H_exp", "H_lin", "Q", "b", "C1", "g1", "C2", "g2", "K", "m", "rate0", "C", "rate1", "slope")
NAMES += ("share", "length", "upper", "drop", "amount", "scale", "c0", "tau", "part", "power", "fall")
OFF = {"b": 60.0, "g1": 100.0, "m": 0.2, "rate0": 1e-3, "rate1": 1e-4, "length": 0.02, "drop": 1e-3, "scale": 0.02, "power": 1.0}
BOUNDS = {"E": (1e3, 5e5), "M_y0": (0.5, 3e3), "M_yinf": (1.0, 6e3), "H_exp": (0.03, 3e3), "H_lin": (-5e3, 1e5), "Q": (-1e3, 1e3)}
BOUNDS |= {"b": (0.1, 5e3), "C1": (0.0, 5e6), "g1": (1e-3, 1e4), "C2": (0.0, 5e6), "g2": (0.0, 1e4), "K": (0.0, 2e3), "m": (0.02, 1.0)}
BOUNDS |= {"rate0": (1e-9, 1e4), "C": (0.0, 0.5), "rate1": (1e-9, 1e4), "slope": (-0.02, 0.02), "share": (0.0, 3.0), "length": (1e-3, 0.2)}
BOUNDS |= {"upper": (0.0, 500.0), "drop": (1e-5, 0.05), "amount": (0.0, 0.9), "scale": (1e-4, 10.0)}
BOUNDS |= {"part": (-2.0, 2.0), "power": (0.2, 8.0), "fall": (-1e-3, 5e-3)}
"""Those of the effects of the catalogue."""
POSITIVE = {"E", "M_y0", "M_yinf", "H_exp", "b", "g1", "m", "rate0", "rate1", "length", "drop", "scale", "power"}
"""Fitted by their logarithm."""
SIZE = {
    "H_lin": 200.0,
    "Q": 50.0,
    "C1": 1e4,
    "C2": 1e3,
    "g2": 5.0,
    "K": 20.0,
    "C": 0.01,
    "slope": 1e-3,
    "share": 0.5,
    "upper": 20.0,
    "amount": 0.1,
    "part": 0.1,
    "fall": 1e-4,
}
TERMS: dict[str, tuple[tuple[str, ...], tuple[tuple[float, ...], ...]]] = {
    "lin": (("H_lin",), ((100.0,),)),
    "voce2": (("Q", "b"), ((-50.0, 20.0), (-50.0, 200.0), (50.0, 5.0), (50.0, 60.0), (50.0, 800.0), (50.0, 3000.0))),
    "af1": (("C1", "g1"), ((5e4, 1000.0), (1e4, 100.0), (2e5, 3000.0))),
    "af2": (("C2", "g2"), ((1000.0, 5.0), (2000.0, 20.0))),
    "power": (("K", "m", "rate0"), ((5.0, 0.2, 1e-3), (20.0, 0.1, 1e-2))),
    "log": (("C", "rate1"), ((0.01, 1e-4), (0.02, 1e-6), (0.1, 1.0))),
    "soft": (("slope",), ((5e-4,),)),
    "softpower": (("part", "power"), ((0.1, 1.0), (0.1, 2.0))),
    "modulus": (("fall",), ((5e-4,),)),
    "plateau": (("share", "length"), ((0.8, 0.015), (0.5, 0.03))),
    "upper": (("upper", "drop"), ((20.0, 1e-3),)),
    "damage": (("amount", "scale"), ((0.1, 0.01),)),
}
STEP = 5e-4
"""Largest strain of a step."""


@njit(cache=True)
def _yield_stress(p: float, rate: float, theta: float, P: np.ndarray) -> float:
    voce = P[2] - P[1]
    s = P[1] + voce * (1.0 - math.exp(-P[3] * p)) + P[4] * p + P[5] * (1.0 - math.exp(-P[6] * p))
    if P[17] != 0.0:
        soft = (0.1 * P[18]) ** 2
        late = 0.5 * (p - P[18] + math.sqrt((p - P[18]) ** 2 + soft)) - 0.5 * (-P[18] + math.sqrt(P[18] ** 2 + soft))
        s += P[17] * (voce * (math.exp(-P[3] * p) - math.exp(-P[3] * late)) + P[19] * math.exp(-p / P[20]))
    s += P[11] * ((1.0 + rate / P[13]) ** P[12] - 1.0)
    if P[25] != 0.0:
        warm = 0.01 * (theta - 293.15)
        s *= 1.0 - P[25] * warm * (warm * warm + 1e-4) ** (0.5 * (P[26] - 1.0))
    return s * (1.0 - P[16] * (theta - 293.15)) * (1.0 + P[14] * math.log(1.0 + rate / P[15]))


@njit(cache=True)
def stresses(time: np.ndarray, eps: np.ndarray, start: float, P: np.ndarray) -> np.ndarray:
    """True stress in MPa (n,) along true strain (n,) at times (n,) in s from the temperature `start` in K."""
    out = np.empty(len(time))
    p = flow = X1 = X2 = before = 0.0
    theta = start
    for k in range(len(time)):
        whole = max(time[k] - time[k - 1] if k > 0 else time[1] - time[0], 1e-12)
        parts = max(1, min(100, int(abs(eps[k] - before) / STEP) + 1))
        dt = whole / parts
        for j in range(1, parts + 1):
            modulus = P[0] * (1.0 - P[21] * (1.0 - math.exp(-p / P[22]))) * (1.0 - P[27] * (theta - 293.15))
            trial = modulus * (before + (eps[k] - before) * j / parts - flow)
            n = 1.0 if trial - X1 - X2 >= 0.0 else -1.0
            dp = 0.0
            if abs(trial - X1 - X2) > _yield_stress(p, 0.0, theta, P):
                low, high = 0.0, abs(trial - X1 - X2) / modulus
                for _ in range(200):
                    dp = 0.5 * (low + high)
                    back = (X1 + P[7] * n * dp) / (1.0 + P[8] * dp) + (X2 + P[9] * n * dp) / (1.0 + P[10] * dp)
                    if n * (trial - back) - modulus * dp > _yield_stress(p + dp, dp / dt, theta, P):
                        low = dp
                    else:
                        high = dp
                    if high - low < 1e-15:
                        break
                X1 = (X1 + P[7] * n * dp) / (1.0 + P[8] * dp)
                X2 = (X2 + P[9] * n * dp) / (1.0 + P[10] * dp)
                p += dp
                flow += n * dp
            fade = math.exp(-dt / P[24])
            theta = start + (theta - start) * fade + P[1] * dp / P[23] / dt * P[24] * (1.0 - fade)
            out[k] = modulus * (before + (eps[k] - before) * j / parts - flow)
        before = eps[k]
    return out


def read(run: Path) -> tuple[list[dict], dict[str, float], float | None]:
    """Records of `interpolate` (time, strain, stress, start, sigma), start values, and rms over noise of the loop (None: not run)."""
    with h5py.File(run / "identify-plastic.h5") as file:
        start = {n: float(file[f"parameters/{n}"][()]) for n in ("E", "M_y0", "M_yinf", "H_exp", "c0", "tau")}
    with h5py.File(run / "identify-elastic.h5") as file:
        E = float(file["parameters/E"][()])
    records = []
    with h5py.File(run / "interpolate.h5") as file:
        for k, facts in enumerate(json.loads(file.attrs["summary"])["tests"]):
            time, strain, stress = (file[f"records/{k}/{n}"][()] for n in ("time", "strain", "stress"))
            sigma = math.hypot(facts["noise"]["stress"], E * facts["noise"]["strain"])
            part = f"records/{k}/first_loading"
            first = tuple(file[f"{part}/{n}"][()] for n in ("strain", "stress")) if part in file else (strain, stress)
            one = {"name": facts["name"], "time": time, "e": strain, "s": stress, "start": facts["theta_start"], "sigma": sigma}
            records.append(one | {"first": first})
    loop = None
    if (run / "close-loop.h5").exists():
        with h5py.File(run / "close-loop.h5") as file:
            rows = file["residual/channel"][()] == 0
            loop = float(np.sqrt(np.mean(file["residual/value"][()][rows] ** 2)))
    return records, start, loop


def predicted(record: dict, P: np.ndarray) -> np.ndarray:
    """Nominal stress of a record, MPa."""
    return stresses(record["time"], np.log1p(record["e"]), record["start"], P) / (1.0 + record["e"])


def fit(
    records: list[dict], start: dict[str, float], terms: tuple[str, ...], held: tuple[str, ...]
) -> tuple[float, float, dict[str, float]]:
    """rms over noise, rms in MPa and parameters of the best of the starts."""
    base = dict.fromkeys(NAMES, 0.0) | OFF | start
    free = [n for n in ("E", "M_y0", "M_yinf", "H_exp") if n not in held] + [n for t in terms for n in TERMS[t][0]]
    low, high = (np.array([math.log(BOUNDS[n][k]) if n in POSITIVE else BOUNDS[n][k] for n in free]) for k in (0, 1))

    def vector(x: np.ndarray) -> np.ndarray:
        values = base | {n: math.exp(v) if n in POSITIVE else v for n, v in zip(free, x, strict=True)}
        return np.array([values[n] for n in NAMES])

    def residual(x: np.ndarray) -> np.ndarray:
        r = np.concatenate([(predicted(q, vector(x)) - q["s"]) / q["sigma"] for q in records])
        return np.where(np.isfinite(r), r, 1e6)

    best = None
    for choice in itertools.islice(itertools.product(*(TERMS[t][1] for t in terms)), 24):
        own = base | {n: v for t, values in zip(terms, choice, strict=True) for n, v in zip(TERMS[t][0], values, strict=True)}
        x = np.array([math.log(own[n]) if n in POSITIVE else own[n] for n in free])
        scale = np.array([1.0 if n in POSITIVE else SIZE[n] for n in free])
        found = least_squares(
            residual, np.clip(x, low + 1e-9, high - 1e-9), bounds=(low, high), x_scale=scale, diff_step=1e-6, max_nfev=200
        )
        best = found if best is None or found.cost < best.cost else best
    assert best is not None
    P = vector(best.x)
    misfit = np.concatenate([predicted(q, P) - q["s"] for q in records])
    parameters = dict(zip(NAMES, P, strict=True))
    return float(np.sqrt(np.mean(residual(best.x) ** 2))), float(np.sqrt(np.mean(misfit**2))), {n: parameters[n] for n in free}


def slope(record: dict) -> tuple[float, float]:
    """Slope in MPa of the first loading and its relative standard error, NaN where fewer than three samples tell it.

    Of all samples of the file, the strain by regression over the stress, because the noise is that of the strain: the other way round noise
    of a twentieth of the elastic strain takes some per cent off the slope. Between a tenth and a half of the 0.2 % proof stress (iterated),
    with no search for a better window: what the program takes is compared with this.
    """
    e, s = (np.abs(x - x[0]) for x in record["first"])
    n = int(np.argmax(s >= 0.99 * s.max())) + 1
    level, found = 0.5 * s.max(), (math.nan, math.nan, math.nan)
    for _ in range(20):
        found = _line(e[:n], s[:n], 0.1 * level, 0.5 * level)
        if math.isnan(found[0]):
            break
        past = np.flatnonzero((s[:n] < found[0] * (e[:n] - found[2] - 0.002)) & (s[:n] > 0.3 * level))
        level = s[past[0]] if len(past) else s.max()
    return found[0], found[1]


def _line(e: np.ndarray, s: np.ndarray, low: float, high: float) -> tuple[float, float, float]:
    """Slope, its relative standard error and strain at no stress of a line of strain over stress between two stresses; the samples count as
    many as their scatter, correlated as a first-order process, is worth."""
    chosen = np.flatnonzero((s > low) & (s < high))
    chosen = chosen[chosen < int(np.argmax(s >= high))]
    if len(chosen) < 3:
        return math.nan, math.nan, math.nan
    x, y = s[chosen], e[chosen]
    by, zero = np.polyfit(x, y, 1)
    left = y - by * x - zero
    follows = min(max(float(left[1:] @ left[:-1]) / float(left @ left), 0.0), 1.0 - 1.0 / len(x)) if left.any() else 0.0
    error = math.sqrt(float(left @ left) / max(len(x) - 2, 1) * (1.0 + follows) / (1.0 - follows) / float(np.sum((x - x.mean()) ** 2)))
    return 1.0 / float(by), error / abs(float(by)), float(zero)


def said_slopes(records: list[dict]) -> str:
    """Slopes of the records in GPa, their mean and median, and the standard error of the mean from the scatter between them."""
    found = {q["name"]: slope(q) for q in records}
    known = np.array([value for value, _ in found.values() if math.isfinite(value)]) / 1e3
    words = ", ".join(f"{name} {value / 1e3:.1f} +- {100.0 * error:.1f} %" for name, (value, error) in found.items())
    if len(known) < 2:
        return words
    error = float(known.std(ddof=1) / len(known) ** 0.5 / known.mean())
    return f"{words}; mean {known.mean():.2f} +- {100.0 * error:.1f} %, median {np.median(known):.2f}"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run_dir", type=Path)
    parser.add_argument("terms", nargs="*", help="sums of " + ", ".join(TERMS))
    parser.add_argument("--hold", action="append", default=[], help="E, for records without an elastic range")
    chosen = parser.parse_args()
    records, start, loop = read(chosen.run_dir)
    print("slope of the first loading, GPa:", said_slopes(records))
    print("loop: " + ("not run" if loop is None else f"{loop:.3f} times the noise"))
    for words in ("", *chosen.terms):
        terms = tuple(w for w in words.split("+") if w)
        over, rms, parameters = fit(records, start, terms, tuple(chosen.hold))
        print(
            f"voce{'+' + words if words else ''}: {over:.3f} times the noise, {rms:.3f} MPa;",
            {n: float(f"{v:.4g}") for n, v in parameters.items()},
        )


if __name__ == "__main__":
    main()
