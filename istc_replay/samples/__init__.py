"""Sample scenes, driven by vehicles that take no notice of each other: pure data, no files."""
