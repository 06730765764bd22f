"""Dead reckoning and motion models."""
