"""Safe-direction navigation (Trihatmo)."""
