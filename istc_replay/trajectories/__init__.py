"""Layer 2: in-corridor trajectories, eq. (13) to (19)."""
