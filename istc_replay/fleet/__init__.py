"""Fleets: thousands of logs, on one machine or many, of which none is lost."""
