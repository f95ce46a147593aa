"""The view in Rerun: a result as its recording, its blueprint, and the viewer that shows it."""
