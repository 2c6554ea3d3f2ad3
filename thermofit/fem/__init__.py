"""Geometry and equilibrium: mesh, elements, boundary, linear algebra, march in time."""
