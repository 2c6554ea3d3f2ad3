"""What a stage leaves behind: artefacts, checkpoints, when they are stale; tasks that run side by side, and progress."""
