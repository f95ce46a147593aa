"""The one error root; each child names the step that failed and its exit code."""

from __future__ import annotations


class IstcReplayError(Exception):
    """An expected failure, told in one line: the value, the rule, the remedy."""

    exit_code = 4


class UsageError(IstcReplayError):
    """A command was called with arguments that cannot be used."""

    exit_code = 2


class ConfigError(IstcReplayError):
    """A configuration file or value breaks a rule of the configuration model."""

    exit_code = 2


class LogError(IstcReplayError):
    """A log cannot be read, or holds nothing that can be replayed."""

    exit_code = 3


class ScenarioError(IstcReplayError):
    """The recorded states cannot be made into a scenario."""

    exit_code = 3


class SolveError(IstcReplayError):
    """A solver is missing, died, or returned what it must not."""

    exit_code = 4


class ExportError(IstcReplayError):
    """An output cannot be written whole."""

    exit_code = 2
