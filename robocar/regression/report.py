"""One HTML page on the runs of a folder, readable without a network: tables, box plots, success matrix, trajectories."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from robocar.core import LogFormatError, OccupancyGrid, OutputError, RobocarError
from robocar.core.text import figure_text, html_text
from robocar.formats import Trajectory, read_tum
from robocar.formats.files import write_atomically
from robocar.regression.results import Results, Row, grouped, read_config, read_results
from robocar.regression.tables import COLUMNS, OF_SUCCESSES, interval, summary

BOXES = ("duration", "path_length", "spl", "min_clearance", "position_rmse", "plan_time_max")
MOST_MAPS = 24
"""A page with more is none that anybody reads."""
MOST_WAYS = 200
_STYLE = """
:root { color-scheme: light; --ink: #1c2530; --soft: #5b6775; --line: #d8dee6; --good: #1a7f4b; --bad: #b3261e; }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); max-width: 1180px; margin: 2rem auto; padding: 0 1rem; }
h1 { margin-bottom: 0; } h2 { margin-top: 2.2rem; border-bottom: 1px solid var(--line); padding-bottom: .2rem; }
p.note { color: var(--soft); margin-top: .3rem; } .wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .7rem; text-align: right; white-space: nowrap; }
th { color: var(--soft); font-weight: 600; border-bottom: 1px solid var(--line); position: sticky; top: 0; background: #fff; }
td.name, th.name { text-align: left; } tbody tr:hover { background: #f3f6fa; }
.success { color: var(--good); } .failed { color: var(--bad); } img, svg { max-width: 100%; height: auto; }
figure { display: inline-block; margin: .5rem 1rem .5rem 0; vertical-align: top; } figcaption { color: var(--soft); }
summary { cursor: pointer; color: var(--soft); }
"""


def write_report(folder: str | Path, out: str | Path | None = None) -> Path:
    """Write the page; by default `<folder>/report.html`.

    Raises:
        LogFormatError: there are no runs.
        OutputError: the page cannot be written.
    """
    folder = Path(folder)
    path = Path(out) if out is not None else folder / "report.html"
    results = read_results(folder)
    title = str(results.sweep.get("suite", folder.resolve().name))
    parts = [
        f"<h1>{html_text(title)}</h1>",
        f'<p class="note">{html_text(str(results.sweep.get("description", "")))}</p>',
        f'<p class="note">{_provenance(results)}</p>',
        _skipped(results),
        "<h2>Navigators</h2>",
        _summary_table(results, ("navigator",)),
        "<h2>Success</h2>",
        _matrix(results.rows),
        "<h2>Spread over the runs</h2>",
        _boxes(results),
        "<h2>Ways driven</h2>",
        *_maps(folder, results),
        "<h2>Scenarios</h2>",
        _summary_table(results, ("scenario", "navigator")),
        "<h2>Runs</h2>",
        _runs_table(results, path.resolve().parent),
    ]
    page = f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{html_text(title)}</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>{_STYLE}</style></head>
<body>
{chr(10).join(parts)}
</body></html>
"""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{path}: cannot write: {error.strerror or error}") from error
    write_atomically(path, page.encode())
    return path


def _provenance(results: Results) -> str:
    prints = sorted({row.fingerprint for row in results.rows if row.fingerprint})
    versions = {f"{name} {version}" for row in results.rows for name, version in row.versions.items()}
    return html_text(f"{len(results.rows)} runs; fingerprints: {', '.join(prints) or 'none'}; {', '.join(sorted(versions))}")


def _skipped(results: Results) -> str:
    if not results.skipped:
        return ""
    items = "".join(f"<li>{html_text(text)}</li>" for text in results.skipped)
    return f'<p class="failed">{len(results.skipped)} entries of the folder are no runs:</p><ul>{items}</ul>'


class Html(str):
    """A text that is HTML already."""


def _address(file: Path, home: Path) -> str:
    return quote(os.path.relpath(file, home), errors="surrogateescape")


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], names: int, label: str) -> str:
    """Cells are texts, or `Html`; the first `names` columns are set to the left."""

    def row(cells: Sequence[str], tag: str) -> str:
        marks = [' class="name"' if i < names else "" for i in range(len(cells))]
        shown = [cell if isinstance(cell, Html) else html_text(cell) for cell in cells]
        return "<tr>" + "".join(f"<{tag}{mark}>{cell}</{tag}>" for mark, cell in zip(marks, shown, strict=True)) + "</tr>"

    body = "".join(row(cells, "td") for cells in rows)
    return f'<div class="wide"><table id="{label}"><thead>{row(head, "th")}</thead><tbody>{body}</tbody></table></div>'


def _summary_table(results: Results, keys: Sequence[str]) -> str:
    units = {name: f" [{unit}]" if unit not in ("", "1") else "" for name, unit in results.units.items()}
    head = [*keys, "runs", "success", *(f"{name}{units.get(name, '')}" for name in COLUMNS), "errors"]
    rows = [
        [
            *line.group,
            str(line.runs),
            interval(line.success, ".2f"),
            *(interval(line.metrics[name]) for name in COLUMNS),
            str(line.errors),
        ]
        for line in summary(results.rows, keys)
    ]
    note = f"Means with 95 % intervals; {' and '.join(sorted(OF_SUCCESSES))} over the runs that reached the goal."
    return _table(head, rows, len(keys), "by-" + "-".join(keys)) + f'<p class="note">{note}</p>'


def _runs_table(results: Results, home: Path) -> str:
    head = ["run", "status", *COLUMNS, "recording", "reason"]
    rows = []
    for row in results.rows:
        recording = results.source.resolve() / row.name / "run.rrd"
        link = Html(f'<a href="{_address(recording, home)}">run.rrd</a>') if recording.is_file() else "–"
        values = [row.metrics.get(name) for name in COLUMNS]
        cells = ["–" if value is None else f"{value:.4g}" for value in values]
        state = Html(f'<span class="{"success" if row.success else "failed"}">{html_text(row.status)}</span>')
        rows.append([row.name, state, *cells, link, row.reason])
    return _table(head, rows, 2, "runs")


def _matrix(rows: Sequence[Row]) -> str:
    """Share of successes by scenario and navigator, as a heat map."""
    scenarios = sorted({row.scenario for row in rows})
    navigators = sorted({row.navigator for row in rows})
    groups = grouped(rows, ("scenario", "navigator"))
    shares = np.full((len(scenarios), len(navigators)), np.nan)
    for i, scenario in enumerate(scenarios):
        for j, navigator in enumerate(navigators):
            members = groups.get((scenario, navigator), [])
            if members:
                shares[i, j] = sum(row.success for row in members) / len(members)
    with _figure((2.5 + 1.1 * len(navigators), 1.2 + 0.36 * len(scenarios))) as (figure, axes):
        image = axes.imshow(shares, cmap="RdYlGn", vmin=0.0, vmax=1.0, aspect="auto", alpha=0.6)
        axes.set_xticks(range(len(navigators)), map(figure_text, navigators), rotation=30, ha="right")
        axes.set_yticks(range(len(scenarios)), map(figure_text, scenarios))
        for i, j in np.argwhere(np.isfinite(shares)):
            members = groups[scenarios[i], navigators[j]]
            axes.text(j, i, f"{sum(row.success for row in members)}/{len(members)}", ha="center", va="center", fontsize=9)
        figure.colorbar(image, ax=axes, label="share of successes", fraction=0.05)
        return _svg(figure, "success matrix")


def _boxes(results: Results) -> str:
    """One box plot per metric, one box per navigator."""
    groups = grouped(results.rows, ("navigator",))
    found = []
    for metric in BOXES:
        values = [
            [v for row in members if (row.success or metric not in OF_SUCCESSES) and (v := row.metrics.get(metric)) is not None]
            for members in groups.values()
        ]
        if not any(values):
            continue
        with _figure((4.6, 0.9 + 0.36 * len(groups))) as (figure, axes):
            axes.boxplot(values, orientation="horizontal", tick_labels=[figure_text(name) for (name,) in groups], widths=0.6)
            unit = results.units.get(metric, "")
            axes.set_xlabel(figure_text(metric + (f" [{unit}]" if unit not in ("", "1") else "")))
            axes.invert_yaxis()
            found.append(f"<figure>{_svg(figure, f'box plot of {metric}')}</figure>")
    return "".join(found)


def _maps(folder: Path, results: Results) -> Iterator[str]:
    """The true trajectories of each scenario over its map."""
    colors = {name: f"C{i % 10}" for i, name in enumerate(sorted({row.navigator for row in results.rows}))}
    scenarios = list(grouped(results.rows, ("scenario",)).items())
    for (scenario,), rows in scenarios[:MOST_MAPS]:
        ways = [(row, way) for row in rows[:MOST_WAYS] if (way := _way(folder / row.name)) is not None and len(way.times)]
        if not ways:
            continue
        with _figure((4.9, 4.4)) as (figure, axes):
            grid, outlines = _world(folder / ways[0][0].name)
            for outline in outlines:
                axes.fill(*outline.T, color="0.75", zorder=1)
            if grid is not None:
                corners = grid.corners()
                axes.imshow(_upright(grid), cmap="Greys", vmin=0, vmax=160, origin="lower", extent=_extent(corners), zorder=0)
            for row, way in ways:
                x, y = way.poses[:, 0], way.poses[:, 1]
                axes.plot(x, y, color=colors[row.navigator], lw=1.0, alpha=0.8, zorder=2)
                axes.plot(x[-1], y[-1], marker="o" if row.success else "x", color=colors[row.navigator], ms=5, zorder=3)
            for name in sorted({row.navigator for row, _ in ways}):
                axes.plot([], [], color=colors[name], label=figure_text(name))
            axes.set_aspect("equal")
            axes.set_xlabel("x [m]")
            axes.set_ylabel("y [m]")
            axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3, frameon=False)
            caption = f"{scenario}: {len(ways)} runs; a dot where the goal was reached, a cross where not"
            yield f"<figure>{_png(figure, f'ways of {scenario}')}<figcaption>{html_text(caption)}</figcaption></figure>"
    if len(scenarios) > MOST_MAPS:
        yield f'<p class="note">{len(scenarios) - MOST_MAPS} more scenarios are not drawn.</p>'


def _way(run: Path) -> Trajectory | None:
    try:
        return read_tum(run / "truth.tum")
    except LogFormatError:
        return None


def _world(run: Path) -> tuple[OccupancyGrid | None, list[np.ndarray]]:
    """The map that a run was driven on, and outlines (n, 2) [m] of what stands there beside; nothing where the file is gone."""
    from robocar.formats import load_map
    from robocar.scenario.model import Scenario

    try:
        config = read_config(run)
        place = {"folder": Path(config["folder"])} if "folder" in config else {}
        scenario = Scenario.model_validate(config["scenario"] | place)
        grid = load_map(scenario.file("map"), scenario.resolution)
    except (RobocarError, KeyError, TypeError, ValueError):
        return None, []
    return grid, [obstacle.solid().outline() for obstacle in scenario.unknown_obstacles]


def _upright(grid: OccupancyGrid) -> np.ndarray:
    """The grid sampled along the axes of the map frame, so that a turned map can be drawn too, (rows, cols)."""
    low, high = grid.corners().min(axis=0), grid.corners().max(axis=0)
    cols, rows = np.maximum(np.ceil((high - low) / grid.resolution).astype(int), 1)
    x = low[0] + (np.arange(cols) + 0.5) * (high[0] - low[0]) / cols
    y = low[1] + (np.arange(rows) + 0.5) * (high[1] - low[1]) / rows
    cells = grid.cell_from_world(np.stack(np.meshgrid(x, y), axis=-1))
    inside = grid.contains(cells)
    values = np.zeros(inside.shape)
    values[inside] = np.maximum(grid.data[tuple(cells[inside].T)], 0)
    return values


def _extent(corners: np.ndarray) -> tuple[float, float, float, float]:
    (left, bottom), (right, top) = corners.min(axis=0), corners.max(axis=0)
    return float(left), float(right), float(bottom), float(top)


@contextmanager
def _figure(size: tuple[float, float]) -> Iterator[tuple[Any, Any]]:
    """A figure of its own: no display, no state shared with the caller's pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    yield figure, figure.add_subplot()


def _svg(figure: Any, what: str) -> str:
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    drawing = text.getvalue()
    drawing = drawing[drawing.index("<svg") :]
    return drawing.replace("<svg", f'<svg role="img" aria-label="{html_text(what)}"', 1)


def _png(figure: Any, what: str) -> str:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    return f'<img alt="{html_text(what)}" src="data:image/png;base64,{base64.b64encode(data.getvalue()).decode()}">'
