"""One log's job: a pure function of the log's content, the configuration and the versions."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from istc_replay.config import Config
from istc_replay.ingest.road_file import road_sha256
from istc_replay.pipeline.libraries import versions
from istc_replay.pipeline.run import RUN_OUTPUTS


@dataclass(frozen=True, slots=True)
class Job:
    """One log to do.

    `stamp` tells the log's size and time of change, as the fleet saw it; `force` does it even
    where it is done; `products` are what is made beside result.mcap and the tables. A log of more
    windows than `cut` (0: of any number) is only looked at, so that its windows can be done as
    jobs of their own: with `windows`, first and end, a job plans these alone, to be joined.
    """

    location: str
    name: str
    stamp: str
    fleet: str
    config_toml: str
    version: str
    products: tuple[str, ...] = RUN_OUTPUTS
    force: bool = False
    cut: int = 0
    windows: tuple[int, int] | None = None

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Job:
        """Give the job that `asdict` made plain."""
        windows = values.get("windows")
        plain = {
            "products": tuple(values["products"]),
            "windows": None if windows is None else tuple(windows),
        }
        return cls(**{**values, **plain})

    def to_dict(self) -> dict[str, Any]:
        """Give the job as plain values."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a job ended.

    `status` is done, inconclusive (there are outputs; what they lack is in `error`), failed (there
    are none), lost (its worker died), away (the worker cannot see the log), long (the log has
    `windows`, to be done apart), part (its windows are planned), unstarted (its worker died before
    it could take the job) or stop (no log can be done, as on a full disk).
    """

    status: str
    error: str = ""
    code: int = 0
    log_sha256: str = ""
    receipt_sha256: str = ""
    seconds: float = 0.0
    cpu_s: float = 0.0
    peak_mb: float = 0.0
    worker: str = ""
    reused: bool = False
    windows: int = 0

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Outcome:
        """Give the outcome that `asdict` made plain."""
        return cls(**values)

    def to_dict(self) -> dict[str, Any]:
        """Give the outcome as plain values."""
        return asdict(self)


def config_sha256(config: Config) -> str:
    """Hash what a configuration sets, and the road file that it names; keys not set are left to the log.

    Raises
    ------
    LogError
        If the road file cannot be read.
    """
    values = config.model_dump(mode="json", exclude_unset=True)
    if config.ingest.road_file is not None:
        values["road_sha256"] = road_sha256(Path(config.ingest.road_file))
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


@cache
def version() -> str:
    """What the results depend on besides log and configuration: the versions, and this very code."""
    package = Path(__file__).resolve().parents[1]
    code = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        code.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes())
    # The build of CBC follows the processor; hosts of one fleet may differ in it.
    told = {name: value for name, value in versions().items() if name != "cbc"}
    return hashlib.sha256(json.dumps([told, code.hexdigest()], sort_keys=True).encode()).hexdigest()


def products_key(config_hash: str, products: tuple[str, ...]) -> str:
    """One hash of the configuration and of what is made."""
    return hashlib.sha256(f"{config_hash} {' '.join(sorted(products))}".encode()).hexdigest()
