"""The page `log/about`: what was run, how it ended, what the colours mean."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from robocar.core.text import markdown_text, printable

LEGEND = """
| colour | meaning |
|---|---|
| green | where the car is, and was |
| blue | where it believes to be |
| orange | where its wheels alone would put it |
| magenta | what it plans |
| red ring | goal and its tolerance |
| light blue | what the sonars hear; pale: no echo |
| red to yellow | what the robot knows: obstacles and costs |
| indigo | the map that it was given |
| slate, brown, violet | walls, obstacles, movers of the world |
"""


def flat(result: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Names and values of nested mappings; `{"value", "unit"}` is one value, None is left out."""
    for key, value in result.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            if "value" in value:  # Rerun wants the numbers of one name to be of one type in all recordings of a process
                yield from flat({name: None if value["value"] is None else float(value["value"])})
            else:
                yield from flat(value, "" if key == "metrics" else f"{name}/")
        elif isinstance(value, bool | int | float | str):
            yield printable(name), printable(value) if isinstance(value, str) else value


def page(properties: Mapping[str, Any], result: Mapping[str, Any] | None) -> str:
    """Markdown: a line that says what was run and how it ended, the colours, all numbers."""
    metrics = dict((result or {}).get("metrics", {}))
    facts = dict(flat(properties)) | dict(flat({k: v for k, v in (result or {}).items() if k != "metrics"}))
    shown = [str(facts[name]) for name in ("scenario", "navigator", "estimator", "mapper", "status", "reason") if facts.get(name)]
    lines = [f"**{' · '.join(map(markdown_text, shown))}**", LEGEND] if shown else [LEGEND]
    if metrics:
        values = dict(flat(metrics))
        units = {name: metric.get("unit") or "" for name, metric in metrics.items() if isinstance(metric, Mapping)}
        lines += ["| metric | |", "|---|---|"]
        lines += [
            f"| {markdown_text(name)} | {_text(value)} {markdown_text(str(units.get(name, '')))} |"
            for name, value in values.items()
        ]
    return "\n".join(lines)


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else markdown_text(str(value))
