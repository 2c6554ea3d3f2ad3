"""Equilibrium of a load step, linear algebra, and the march in time."""
