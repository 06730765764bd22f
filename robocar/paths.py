"""Where the data that comes with Robocar lies."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent

MODELS = _PACKAGE / "models" if (_PACKAGE / "models").is_dir() else _PACKAGE.parent / "models"
"""`models/`: inside the package when installed from a wheel, beside it in a checkout."""
