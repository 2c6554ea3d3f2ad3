"""The surface of von Mises: isotropic, no parameters. It is Hill's at F = G = H = 1/2, L = M = N = 3/2."""

from __future__ import annotations

PARAMS = ()
FORMULA = "phi^2 = 3/2 dev S : dev S"
SOURCE = "von Mises 1913, Nachrichten der Gesellschaft der Wissenschaften zu Goettingen"
MEANING: dict[str, str] = {}
