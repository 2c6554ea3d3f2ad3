"""Yield surfaces: one file each, found by themselves and chosen by name in the study. They rest on core alone and compile nothing."""
