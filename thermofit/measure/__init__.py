"""Instruments: readers, infrared camera, image correlation, load cell, observation operators."""
