"""The command line: a file per group of commands over the Python API."""
