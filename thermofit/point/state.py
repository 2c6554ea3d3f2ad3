"""State of a material point of a body, and what a local update answers.

Eleven numbers: F_p^-1 row by row (9), alpha, the accumulated plastic multiplier Lambda. Where a study uses or asks for an effect that
changes the local update itself (law.composition.STRUCTURE), more follow, which its heat needs: tr C_el, the sense of flow at the end of
the last plastic increment, and for each backstress X_i = C_i Y_i the strain-like Y_i (11, 22, 33, 12, 23, 13) on the intermediate
configuration. Old state in, new state out; nothing is changed in between.
"""

from __future__ import annotations

from thermofit.law.composition import BACKSTRESSES

N_STATE = 11
ALPHA, LAMBDA = 9, 10
TRACE, SENSE, BACK = 11, 12, 13
"""Places of tr C_el, of the sense of flow and of the first Y, where a state holds them."""
N_BACK = len(BACKSTRESSES)
N_FULL = BACK + 6 * N_BACK
"""Numbers of a state that holds all."""
ELASTIC, PLASTIC, NO_CONVERGENCE, INVERTED = 0, 1, -1, -2
"""Answers of an update; that of eight points which flow is the number of terms of an exponential."""
YIELD_TOLERANCE = 1e-9
"""Relative excess over the yield stress that still counts as elastic; above the accuracy of the return map, so that a state
left on the yield surface unloads with the elastic tangent."""
