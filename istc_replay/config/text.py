"""The configuration as TOML: reading, with a line a fault, and writing."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from istc_replay.config.model import Config
from istc_replay.errors import ConfigError


def parse_config(text: str, name: str = "config") -> Config:
    """Read a configuration from TOML text.

    Raises
    ------
    ConfigError
        If the text is not TOML, or a key is unknown or out of range; one line a fault.
    """
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{name}: not TOML: {error}") from None
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        raise ConfigError(f"{name}: " + "; ".join(_fault(fault) for fault in error.errors())) from None


def load_config(path: Path | None) -> Config:
    """Read a configuration file; None gives the defaults.

    Raises
    ------
    ConfigError
        If the file cannot be read or breaks a rule.
    """
    if path is None:
        return Config()
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    return parse_config(text, str(path))


def render_config(config: Config, *, explain: bool = False) -> str:
    """Write a configuration as TOML; `parse_config` reads it back to an equal one.

    Parameters
    ----------
    config : Config
        What to write; unset keys are left out (with `explain`, shown as comments).
    explain : bool
        Put each key's meaning above it.
    """
    lines: list[str] = []
    _render(config, "", lines, explain)
    return "\n".join(lines).strip() + "\n"


def _render(section: BaseModel, path: str, lines: list[str], explain: bool) -> None:
    fields = type(section).model_fields
    nested: list[tuple[str, Any, str | None]] = []
    for name, field in fields.items():
        value = getattr(section, name)
        if isinstance(value, (BaseModel, dict)):
            nested.append((name, value, field.description))
            continue
        if explain and field.description:
            lines.append(f"# {field.description}")
        if value is not None:
            lines.append(f"{name} = {_toml(value)}")
        elif explain:
            lines.append(f"# {name} =")
    for name, value, description in nested:
        key = f"{path}.{_key(name)}" if path else _key(name)
        if isinstance(value, BaseModel):
            lines.append("")
            if explain and description:
                lines.append(f"# {description}")
            lines.append(f"[{key}]")
            _render(value, key, lines, explain)
            continue
        if explain and not value:
            lines += ["", f"# {description}", f'# [{key}."..."]']
        plain = {entry: item for entry, item in value.items() if isinstance(item, str)}
        if plain:
            lines += ["", f"[{key}]", *(f"{_key(entry)} = {_toml(item)}" for entry, item in plain.items())]
            continue
        for entry, item in value.items():
            lines += ["", f"[{key}.{_key(entry)}]"]
            _render(item, f"{key}.{_key(entry)}", lines, explain)


def _key(name: str) -> str:
    return name if name.replace("_", "").isalnum() and name.isascii() else _toml(name)


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON's escapes are TOML's, save for DEL, which JSON leaves as it is.
        return json.dumps(value).replace("\x7f", "\\u007f")
    return repr(value)


def _fault(fault: Any) -> str:
    key = ".".join(str(part) for part in fault["loc"])
    if fault["type"] == "extra_forbidden":
        known = ", ".join(_known_keys(fault["loc"][:-1]))
        return f"unknown key {key}; known here: {known}"
    return f"{key} = {fault['input']!r}: {fault['msg']}"


def _known_keys(location: tuple[Any, ...]) -> list[str]:
    model: Any = Config
    for part in location:
        field = model.model_fields.get(part) if hasattr(model, "model_fields") else None
        if field is None:
            # A key of a table of tables: the entries share one model.
            continue
        model = field.annotation
        for candidate in getattr(model, "__args__", ()):
            if hasattr(candidate, "model_fields"):
                model = candidate
    return sorted(getattr(model, "model_fields", {}))
