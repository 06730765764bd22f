"""The command line: a thin layer over the Python API. Heavy imports wait until a command needs them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NoReturn

import tyro

from robocar import __version__
from robocar.cli import check, experiments, listing, regression, run, view
from robocar.cli.output import fail

_COMMANDS: dict[str, Callable[..., int]] = {
    **run.COMMANDS,
    **listing.COMMANDS,
    **experiments.COMMANDS,
    **check.COMMANDS,
    **view.COMMANDS,
    **regression.COMMANDS,
}
_POINTS = ("--start", "--goal")


def main(arguments: list[str] | None = None) -> NoReturn:
    """The console script `robocar`."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words == ["--version"]:
        sys.stdout.write(f"robocar {__version__}\n")
        sys.exit(0)
    # `--start -1,2`: a value that begins with a minus sign is no option.
    for i in range(len(words) - 1, 0, -1):
        if words[i - 1] in _POINTS and words[i].startswith("-"):
            words[i - 1 : i + 1] = [f"{words[i - 1]}={words[i]}"]
    try:
        status = tyro.extras.subcommand_cli_from_dict(
            _COMMANDS,
            args=words,
            prog="robocar",
            description="Mobile-robot navigation in MuJoCo physics without ROS.",
        )
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(130)
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output has gone: nothing left to say
        sys.exit(1)
    except Exception as error:
        from robocar.core import RobocarError

        if "--debug" in words or not isinstance(error, RobocarError):
            raise
        fail(str(error))
    sys.exit(status)
