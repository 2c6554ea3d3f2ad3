"""Products of tensors in lanes with fused multiply-add, a b + c rounded once: for the rates along many directions, which are sums of these.

The formulas are those of `tensor` and `lanes_tensor`. State and stress are calculated without: what they hold does then not depend on
what a processor can do.
"""

from __future__ import annotations

from thermofit.core.jit import kernel
from thermofit.core.lanes import Lanes, multiply_add
from thermofit.law.tensor import Symmetric
from thermofit.point.lanes_tensor import Tensor


@kernel(forceinline=True)
def dot(a0: Lanes, b0: Lanes, a1: Lanes, b1: Lanes, a2: Lanes, b2: Lanes) -> Lanes:
    """a0 b0 + a1 b1 + a2 b2."""
    return multiply_add(a0, b0, multiply_add(a1, b1, a2 * b2))


@kernel(forceinline=True)
def product(a: Tensor, b: Tensor) -> Tensor:
    """a . b."""
    return (
        dot(a[0], b[0], a[1], b[3], a[2], b[6]), dot(a[0], b[1], a[1], b[4], a[2], b[7]), dot(a[0], b[2], a[1], b[5], a[2], b[8]),
        dot(a[3], b[0], a[4], b[3], a[5], b[6]), dot(a[3], b[1], a[4], b[4], a[5], b[7]), dot(a[3], b[2], a[4], b[5], a[5], b[8]),
        dot(a[6], b[0], a[7], b[3], a[8], b[6]), dot(a[6], b[1], a[7], b[4], a[8], b[7]), dot(a[6], b[2], a[7], b[5], a[8], b[8]),
    )  # fmt: skip


@kernel(forceinline=True)
def product_added(c: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """c + a . b."""
    return (
        _dot_added(c[0], a[0], b[0], a[1], b[3], a[2], b[6]), _dot_added(c[1], a[0], b[1], a[1], b[4], a[2], b[7]),
        _dot_added(c[2], a[0], b[2], a[1], b[5], a[2], b[8]),
        _dot_added(c[3], a[3], b[0], a[4], b[3], a[5], b[6]), _dot_added(c[4], a[3], b[1], a[4], b[4], a[5], b[7]),
        _dot_added(c[5], a[3], b[2], a[4], b[5], a[5], b[8]),
        _dot_added(c[6], a[6], b[0], a[7], b[3], a[8], b[6]), _dot_added(c[7], a[6], b[1], a[7], b[4], a[8], b[7]),
        _dot_added(c[8], a[6], b[2], a[7], b[5], a[8], b[8]),
    )  # fmt: skip


@kernel(forceinline=True)
def _dot_added(c: Lanes, a0: Lanes, b0: Lanes, a1: Lanes, b1: Lanes, a2: Lanes, b2: Lanes) -> Lanes:
    return multiply_add(a0, b0, multiply_add(a1, b1, multiply_add(a2, b2, c)))


@kernel(forceinline=True)
def symmetric_sum(a: Tensor, b: Tensor) -> Symmetric:
    """a . b^T + b . a^T."""
    return (
        2.0 * dot(a[0], b[0], a[1], b[1], a[2], b[2]),
        2.0 * dot(a[3], b[3], a[4], b[4], a[5], b[5]),
        2.0 * dot(a[6], b[6], a[7], b[7], a[8], b[8]),
        _dot_added(dot(b[0], a[3], b[1], a[4], b[2], a[5]), a[0], b[3], a[1], b[4], a[2], b[5]),
        _dot_added(dot(b[3], a[6], b[4], a[7], b[5], a[8]), a[3], b[6], a[4], b[7], a[5], b[8]),
        _dot_added(dot(b[0], a[6], b[1], a[7], b[2], a[8]), a[0], b[6], a[1], b[7], a[2], b[8]),
    )


@kernel(forceinline=True)
def added(a: Symmetric, b: Symmetric, factor: Lanes) -> Symmetric:
    """a + factor b."""
    return (
        multiply_add(factor, b[0], a[0]), multiply_add(factor, b[1], a[1]), multiply_add(factor, b[2], a[2]),
        multiply_add(factor, b[3], a[3]), multiply_add(factor, b[4], a[4]), multiply_add(factor, b[5], a[5]),
    )  # fmt: skip


@kernel(forceinline=True)
def double_contraction(a: Symmetric, b: Symmetric) -> Lanes:
    """a : b."""
    return multiply_add(2.0, dot(a[3], b[3], a[4], b[4], a[5], b[5]), dot(a[0], b[0], a[1], b[1], a[2], b[2]))


@kernel(forceinline=True)
def pulled_back(f: Tensor, s: Symmetric) -> Symmetric:
    """f^T . s . f of a symmetric s."""
    t = product((f[0], f[3], f[6], f[1], f[4], f[7], f[2], f[5], f[8]), (s[0], s[3], s[5], s[3], s[1], s[4], s[5], s[4], s[2]))
    return (
        dot(t[0], f[0], t[1], f[3], t[2], f[6]),
        dot(t[3], f[1], t[4], f[4], t[5], f[7]),
        dot(t[6], f[2], t[7], f[5], t[8], f[8]),
        dot(t[0], f[1], t[1], f[4], t[2], f[7]),
        dot(t[3], f[2], t[4], f[5], t[5], f[8]),
        dot(t[0], f[2], t[1], f[5], t[2], f[8]),
    )


@kernel(forceinline=True)
def congruence(y: Symmetric, c: Symmetric) -> Symmetric:
    """y . c . y of two symmetric tensors."""
    return pulled_back((y[0], y[3], y[5], y[3], y[1], y[4], y[5], y[4], y[2]), c)
