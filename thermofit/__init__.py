"""thermofit: identify thermo-mechanically coupled plasticity from full-field measurements."""

__version__ = "0.1.0"
