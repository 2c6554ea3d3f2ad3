"""Algebra of general tensors that live in registers: nine numbers row by row, beside the symmetric ones of `material.tensor`."""

from __future__ import annotations

from thermofit.core.jit import kernel
from thermofit.material.tensor import Symmetric, added, congruence, scaled

Tensor = tuple[float, float, float, float, float, float, float, float, float]
"""A general tensor row by row."""


@kernel(forceinline=True)
def product(a: Tensor, b: Tensor) -> Tensor:
    """a . b."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6], a[0] * b[1] + a[1] * b[4] + a[2] * b[7], a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6], a[3] * b[1] + a[4] * b[4] + a[5] * b[7], a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6], a[6] * b[1] + a[7] * b[4] + a[8] * b[7], a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )  # fmt: skip


@kernel(forceinline=True)
def transposed(a: Tensor) -> Tensor:
    """a^T."""
    return (a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8])


@kernel(forceinline=True)
def product_symmetric(a: Tensor, s: Symmetric) -> Tensor:
    """a . s for a symmetric s."""
    return (
        a[0] * s[0] + a[1] * s[3] + a[2] * s[5], a[0] * s[3] + a[1] * s[1] + a[2] * s[4], a[0] * s[5] + a[1] * s[4] + a[2] * s[2],
        a[3] * s[0] + a[4] * s[3] + a[5] * s[5], a[3] * s[3] + a[4] * s[1] + a[5] * s[4], a[3] * s[5] + a[4] * s[4] + a[5] * s[2],
        a[6] * s[0] + a[7] * s[3] + a[8] * s[5], a[6] * s[3] + a[7] * s[1] + a[8] * s[4], a[6] * s[5] + a[7] * s[4] + a[8] * s[2],
    )  # fmt: skip


@kernel(forceinline=True)
def twice_symmetric_part(a: Tensor, b: Tensor) -> Symmetric:
    """a . b^T + b . a^T."""
    return (
        2.0 * (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]),
        2.0 * (a[3] * b[3] + a[4] * b[4] + a[5] * b[5]),
        2.0 * (a[6] * b[6] + a[7] * b[7] + a[8] * b[8]),
        a[0] * b[3] + a[1] * b[4] + a[2] * b[5] + b[0] * a[3] + b[1] * a[4] + b[2] * a[5],
        a[3] * b[6] + a[4] * b[7] + a[5] * b[8] + b[3] * a[6] + b[4] * a[7] + b[5] * a[8],
        a[0] * b[6] + a[1] * b[7] + a[2] * b[8] + b[0] * a[6] + b[1] * a[7] + b[2] * a[8],
    )  # fmt: skip


@kernel(forceinline=True)
def square(a: Tensor) -> Symmetric:
    """a . a^T."""
    return scaled(twice_symmetric_part(a, a), 0.5)


@kernel(forceinline=True)
def pulled_back(f: Tensor, s: Symmetric) -> Symmetric:
    """f^T . s . f."""
    t = product(transposed(f), (s[0], s[3], s[5], s[3], s[1], s[4], s[5], s[4], s[2]))
    return (
        t[0] * f[0] + t[1] * f[3] + t[2] * f[6],
        t[3] * f[1] + t[4] * f[4] + t[5] * f[7],
        t[6] * f[2] + t[7] * f[5] + t[8] * f[8],
        t[0] * f[1] + t[1] * f[4] + t[2] * f[7],
        t[3] * f[2] + t[4] * f[5] + t[5] * f[8],
        t[0] * f[2] + t[1] * f[5] + t[2] * f[8],
    )


@kernel(forceinline=True)
def total(a: Tensor, b: Tensor) -> Tensor:
    """a + b."""
    return (
        a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5], a[6] + b[6], a[7] + b[7], a[8] + b[8],
    )  # fmt: skip


@kernel(forceinline=True)
def mixed_congruence(dy: Symmetric, c: Symmetric, y: Symmetric) -> Symmetric:
    """dy . c . y + y . c . dy, by polarisation of y . c . y."""
    return added(congruence(added(y, dy, 0.5), c), congruence(added(y, dy, -0.5), c), -1.0)
