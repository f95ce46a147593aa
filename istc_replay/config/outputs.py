"""The configuration's sections `certificate` and `view`: what is checked of a plan and how it is shown."""

from __future__ import annotations

from istc_replay.config.sections import NonNegative, Positive, Section


class CertificateConfig(Section):
    """Certificates of a plan."""

    step_s: Positive = 0.01
    """Longest step of the re-integration."""
    drift_tolerance_m: Positive = 0.05
    """Largest distance between written and re-integrated states."""
    tolerance_m: Positive = 1e-6
    """Rounding allowed in distances."""
    limit_tolerance: Positive = 1e-5
    """Rounding allowed in steering, acceleration and speed limits."""
    separation_m: NonNegative = 0.0
    """Least distance between two planned boxes; their cubes' gap is checked as well."""


class ViewConfig(Section):
    """The Rerun view."""

    metres_per_second: Positive | None = None
    """Height of a second in the (x, y, t) view; without it as the scene's size wants."""
