"""The whole configuration."""

from __future__ import annotations

from istc_replay.config.audit import AuditConfig
from istc_replay.config.corridors import CorridorsConfig
from istc_replay.config.guidance import GuidanceConfig
from istc_replay.config.ingest import IngestConfig
from istc_replay.config.outputs import CertificateConfig, ViewConfig
from istc_replay.config.scenario import VehiclesConfig, WindowConfig
from istc_replay.config.sections import Section
from istc_replay.config.trajectories import TrajectoriesConfig


class Config(Section):
    """The whole configuration."""

    ingest: IngestConfig = IngestConfig()
    """Reading logs."""
    window: WindowConfig = WindowConfig()
    """Cutting the log into windows."""
    vehicles: VehiclesConfig = VehiclesConfig()
    """Dimensions and priorities."""
    guidance: GuidanceConfig = GuidanceConfig()
    """Guidance trajectories."""
    corridors: CorridorsConfig = CorridorsConfig()
    """Layer 1."""
    trajectories: TrajectoriesConfig = TrajectoriesConfig()
    """Layer 2."""
    certificate: CertificateConfig = CertificateConfig()
    """Certificates."""
    audit: AuditConfig = AuditConfig()
    """The safety audit of recorded traffic."""
    view: ViewConfig = ViewConfig()
    """The Rerun view."""
