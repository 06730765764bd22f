"""Mobile-robot navigation in MuJoCo physics: see README.md. The stable API is `robocar.run(...)`."""

__version__ = "0.1.0"
