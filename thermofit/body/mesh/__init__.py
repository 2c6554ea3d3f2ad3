"""Meshes: shapes of specimens, files of others, named sets, quality."""
