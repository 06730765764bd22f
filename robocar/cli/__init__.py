"""The command line: a file per group of commands over the Python API."""

from robocar.cli.commands import main

__all__ = ["main"]
