"""Physical and measurement effects, one file each."""
