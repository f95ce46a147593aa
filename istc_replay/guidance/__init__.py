"""Guidance trajectories: what each vehicle would drive if it were alone."""
