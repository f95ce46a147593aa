"""The seed of hard scenes: whole motions along candidate paths that keep clear of each other."""
