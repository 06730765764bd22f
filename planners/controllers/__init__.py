"""From a path to commands: pure pursuit, Dynamic Window Approach, model predictive path integral control."""
