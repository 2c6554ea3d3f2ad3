"""Vocabulary, records and errors: the ground floor, which imports nothing of the house."""
