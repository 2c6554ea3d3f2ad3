"""From fields to what instruments show of them, and back: channels, cameras, force, noise, comparison with a prediction."""
