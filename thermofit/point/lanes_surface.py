"""Direction and curvature of the yield surface in lanes, of whichever kind the law has: its type says so when kernels are compiled.

Of a quadratic surface phi d2phi/dS2 = G - N N takes no memory; that of a transformed one (law.transformed) stands in N_CURVATURE rows, of a
workspace or of the response of a point.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.jit import by_type, kernel
from thermofit.core.lanes import Lanes, spread
from thermofit.law.page import Law, hill, transformed
from thermofit.law.tensor import Symmetric, added, deviator, double_contraction
from thermofit.law.transformed import flow_and_curvature, flow_of
from thermofit.point.lanes_memory import number, row, set_row
from thermofit.point.lanes_rows import FLOW_ACCURACY, flow_direction


@kernel(forceinline=True)
def _set_column(w: np.ndarray, at: int, n: int, s: Symmetric) -> None:
    set_row(w, at + n, s[0])
    set_row(w, at + 5 + n, s[1])
    set_row(w, at + 10 + n, s[3])
    set_row(w, at + 15 + n, s[4])
    set_row(w, at + 20 + n, s[5])


@kernel(forceinline=True)
def _flow_and_rows(t: Symmetric, law: Law, w: np.ndarray, at: int) -> tuple[Symmetric, Lanes]:
    flow, norm, curvature = flow_and_curvature(t, law)
    _set_column(w, at, 0, curvature[0])
    _set_column(w, at, 1, curvature[1])
    _set_column(w, at, 2, curvature[2])
    _set_column(w, at, 3, curvature[3])
    _set_column(w, at, 4, curvature[4])
    return flow, norm


@kernel(forceinline=True)
def _curved(c: np.ndarray, at: int, a: Symmetric) -> Symmetric:
    """phi d2phi/dS2 : a of rows, all of them of the same points as a."""
    b, o = deviator(a), spread(0.0)
    s0, s1, s2, s3, s4 = o, o, o, o, o
    for k in range(5):
        value = b[0] if k == 0 else b[1] if k == 1 else b[3] if k == 2 else b[4] if k == 3 else b[5]
        s0, s1 = s0 + row(c, at + k) * value, s1 + row(c, at + 5 + k) * value
        s2, s3, s4 = s2 + row(c, at + 10 + k) * value, s3 + row(c, at + 15 + k) * value, s4 + row(c, at + 20 + k) * value
    return (s0, s1, -s0 - s1, s2, s3, s4)


@kernel(forceinline=True)
def _curved_at(c: np.ndarray, q: int, at: int, a: Symmetric) -> Symmetric:
    """The same of point q of the rows; the lanes of a are directions."""
    b, o = deviator(a), spread(0.0)
    s0, s1, s2, s3, s4 = o, o, o, o, o
    for k in range(5):
        value = b[0] if k == 0 else b[1] if k == 1 else b[3] if k == 2 else b[4] if k == 3 else b[5]
        s0, s1 = s0 + number(c, at + k, q) * value, s1 + number(c, at + 5 + k, q) * value
        s2, s3 = s2 + number(c, at + 10 + k, q) * value, s3 + number(c, at + 15 + k, q) * value
        s4 = s4 + number(c, at + 20 + k, q) * value
    return (s0, s1, -s0 - s1, s2, s3, s4)


@kernel(forceinline=True)
def _projected(a: Symmetric, flow: Symmetric, law: Law) -> Symmetric:
    """(G - N N) : a."""
    return added(hill(a, law), flow, -double_contraction(flow, a))


def surface_flow(t: Symmetric, law: Law) -> tuple[Symmetric, Lanes]:
    """In kernels: N = dphi/dS and phi at a stress (4.14), (4.19)."""
    raise NotImplementedError


@by_type(surface_flow)
def _surface_flow(t: Any, law: Any) -> Any:
    return (lambda t, law: flow_of(t, law)) if transformed(law) else (lambda t, law: flow_direction(t, law))


def surface_flow_and_curvature(t: Symmetric, law: Law, w: np.ndarray, at: int) -> tuple[Symmetric, Lanes]:
    """In kernels: the same, and the rows from `at` on that `projected` and `projected_at` need."""
    raise NotImplementedError


@by_type(surface_flow_and_curvature)
def _surface_flow_and_curvature(t: Any, law: Any, w: Any, at: Any) -> Any:
    if transformed(law):
        return lambda t, law, w, at: _flow_and_rows(t, law, w, at)
    return lambda t, law, w, at: flow_direction(t, law)


def flow_accuracy(law: Law) -> float:
    """In kernels: error of D, relative to dLambda, at which a return map has converged. N turns the faster with the stress, and with its
    round-off, the larger the exponent."""
    raise NotImplementedError


@by_type(flow_accuracy)
def _flow_accuracy(law: Any) -> Any:
    return (lambda law: FLOW_ACCURACY * law.surface_a) if transformed(law) else (lambda law: FLOW_ACCURACY)


def projected(a: Symmetric, flow: Symmetric, law: Law, w: np.ndarray, at: int) -> Symmetric:
    """In kernels: P : a, P = phi d2phi/dS2, of the same eight points as the rows."""
    raise NotImplementedError


@by_type(projected)
def _projected_of(a: Any, flow: Any, law: Any, w: Any, at: Any) -> Any:
    if transformed(law):
        return lambda a, flow, law, w, at: _curved(w, at, a)
    return lambda a, flow, law, w, at: _projected(a, flow, law)


def projected_at(a: Symmetric, flow: Symmetric, law: Law, c: np.ndarray, at: int, q: int) -> Symmetric:
    """In kernels: P : a of point q of the rows of a response; the lanes of a are directions."""
    raise NotImplementedError


@by_type(projected_at)
def _projected_at_of(a: Any, flow: Any, law: Any, c: Any, at: Any, q: Any) -> Any:
    if transformed(law):
        return lambda a, flow, law, c, at, q: _curved_at(c, q, at, a)
    return lambda a, flow, law, c, at, q: _projected(a, flow, law)
