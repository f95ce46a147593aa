"""The configuration: one strict, frozen model, read from TOML.

Every key carries its unit as suffix. Defaults are the paper's (Tables I and II) where the paper
has them; docs/method.md says why for the others.
"""

from istc_replay.config.audit import HARDEST_BRAKING_MPS2, AuditConfig
from istc_replay.config.corridors import CorridorsConfig
from istc_replay.config.guidance import GuidanceConfig
from istc_replay.config.ingest import ColumnTarget, FieldTarget, IngestConfig, TopicConfig, TopicFormat
from istc_replay.config.model import Config
from istc_replay.config.outputs import CertificateConfig, ViewConfig
from istc_replay.config.scenario import VehicleConfig, VehiclesConfig, WindowConfig
from istc_replay.config.text import load_config, parse_config, render_config
from istc_replay.config.trajectories import TrajectoriesConfig

__all__ = [
    "HARDEST_BRAKING_MPS2",
    "AuditConfig",
    "CertificateConfig",
    "ColumnTarget",
    "Config",
    "CorridorsConfig",
    "FieldTarget",
    "GuidanceConfig",
    "IngestConfig",
    "TopicConfig",
    "TopicFormat",
    "TrajectoriesConfig",
    "VehicleConfig",
    "VehiclesConfig",
    "ViewConfig",
    "WindowConfig",
    "load_config",
    "parse_config",
    "render_config",
]
