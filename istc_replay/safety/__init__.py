"""Certificates of plans and the audit of recorded traffic, apart from the solvers."""
