"""What holds for every command."""

from __future__ import annotations

import subprocess
import sys

from istc_replay.cli import cli

from ..support.commands import Command


def test_help_names_every_command_with_an_example(call: Command) -> None:
    for name, command in cli.commands.items():
        done = call(name, "--help")
        assert done.returncode == 0
        assert f"istc-replay {name}" in done.stdout.split("Example:")[1]
        assert command.help


def test_help_imports_nothing_heavy() -> None:
    script = (
        "import sys\nfrom istc_replay.cli import cli\ncli.main(['--help'], standalone_mode=False)\n"
        "heavy = {'numpy', 'polars', 'casadi', 'pyomo', 'rerun', 'matplotlib', 'pydantic'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")
