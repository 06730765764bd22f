"""What an experiment found, written as numbers and as a page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robocar.core import OutputError
from robocar.core.text import markdown_cell


@dataclass(slots=True)
class Report:
    """What an experiment found: numbers for `summary.json`, tables and text for `report.md`."""

    folder: Path
    title: str
    numbers: dict[str, dict[str, Any]] = field(default_factory=dict)
    text: list[str] = field(default_factory=list)

    def number(self, name: str, value: float | int | None, unit: str, paper: float | None = None) -> None:
        """One result, beside the paper's where it has one."""
        self.numbers[name] = {"value": value, "unit": unit, "paper": paper}

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]], caption: str = "") -> None:
        """A Markdown table; its cells may hold Markdown."""
        lines = [caption, ""] if caption else []
        lines += ["| " + " | ".join(map(_cell, header)) + " |", "|" + "---|" * len(header)]
        lines += ["| " + " | ".join(_cell(cell) for cell in row) + " |" for row in rows]
        self.text.append("\n".join(lines))

    def say(self, paragraph: str) -> None:
        """A paragraph of the report."""
        self.text.append(paragraph)

    def write(self) -> Path:
        """Writes `summary.json` and `report.md`, and returns the latter."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            (self.folder / "summary.json").write_text(json.dumps(self.numbers, indent=1) + "\n")
            path = self.folder / "report.md"
            path.write_text(f"# {self.title}\n\n" + "\n\n".join(self.text) + "\n")
        except OSError as error:
            raise OutputError(f"{self.folder}: cannot write: {error.strerror or error}") from error
        return path


def _cell(value: object) -> str:
    if value is None:
        return "–"
    return f"{value:.3g}" if isinstance(value, float) else markdown_cell(str(value))
