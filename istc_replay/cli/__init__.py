"""The command line: the only place that prints.

Results go to stdout, everything else to stderr. A module a command; heavy modules are imported by
the command that needs them, so that help is instant.
"""

from __future__ import annotations

import sys
import traceback

import click

from istc_replay import __version__, tell
from istc_replay.cli.audit import audit
from istc_replay.cli.bench import bench
from istc_replay.cli.clip import clip
from istc_replay.cli.compare import compare
from istc_replay.cli.config import config
from istc_replay.cli.convert import convert
from istc_replay.cli.export import export
from istc_replay.cli.figures import figures
from istc_replay.cli.fleet import fleet
from istc_replay.cli.info import info
from istc_replay.cli.merge import merge
from istc_replay.cli.recover import recover
from istc_replay.cli.run import run
from istc_replay.cli.sample import sample
from istc_replay.cli.view import view
from istc_replay.errors import IstcReplayError

_INTERNAL_ERROR = 4
_INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code: an error is one line on stderr."""
    given = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in given
    try:
        code = cli.main(
            args=[a for a in given if a != "--debug"], standalone_mode=False, prog_name="istc-replay"
        )
        sys.exit(code if isinstance(code, int) else 0)
    except click.exceptions.Abort:
        _fail("interrupted; what was finished is kept", _INTERRUPTED)
    except KeyboardInterrupt:
        _fail("interrupted; what was finished is kept", _INTERRUPTED)
    except click.ClickException as error:
        _fail(error.format_message(), 2)
    except IstcReplayError as error:
        if debug:
            traceback.print_exc()
        _fail(str(error), error.exit_code)
    except BrokenPipeError:
        # The reader of stdout has gone, as with `| head`: nothing is left to tell it.
        sys.stderr.close()
        sys.exit(0)
    except MemoryError:
        _fail("out of memory; cut the log into shorter spans", _INTERNAL_ERROR)
    except SystemExit:
        raise
    except BaseException as error:  # a panic of a library in Rust is no Exception
        if debug:
            traceback.print_exc()
        _fail(f"internal error: {type(error).__name__}: {error}; --debug shows where", _INTERNAL_ERROR)


def _fail(message: str, code: int) -> None:
    click.echo(f"istc-replay: {tell.line(message)}", err=True)
    sys.exit(code)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="istc-replay")
def cli() -> None:
    """Replay recorded multi-vehicle MCAP logs: what happened, how close it was, and what a coordinated
    plan would have done.

    Every command takes --debug to show the traceback of an error.
    """


for _command in (
    *(run, fleet, info, audit, view, figures, compare, export),
    *(convert, clip, merge, recover, sample, bench, config),
):
    cli.add_command(_command)
