"""`python -m robocar` is the command line."""

from robocar.cli import main

main()
