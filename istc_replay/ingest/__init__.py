"""Reading logs: the only package that reads their bytes."""
