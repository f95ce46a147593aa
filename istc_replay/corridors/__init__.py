"""Layer 1: interactive spatio-temporal corridors, eq. (1) to (12)."""
