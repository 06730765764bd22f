"""`python -m robocar` is the command line."""

from robocar.cli.main import main

main()
