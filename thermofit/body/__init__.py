"""Geometry and equilibrium of a specimen: mesh, elements, heat, march in time, sensitivities. It knows no material by its name."""
