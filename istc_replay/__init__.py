"""istc-replay: replay recorded multi-vehicle logs with interactive spatio-temporal corridors."""

__version__ = "0.1.0"
