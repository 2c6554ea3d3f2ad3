"""Residual structure against the noise floor."""
