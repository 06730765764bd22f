"""What a run is judged by: the run itself, its map, its movers, its localization."""

from robocar.metrics import localization, map, movers, run  # importing them declares their metrics
from robocar.metrics.declaration import Declaration, Metric, Tolerance, declared, metric, metrics, summarize
from robocar.metrics.run_log import DrawnMap, Eye, RunLog, Shape, Track

__all__ = [
    "Declaration",
    "DrawnMap",
    "Eye",
    "Metric",
    "RunLog",
    "Shape",
    "Tolerance",
    "Track",
    "declared",
    "localization",
    "map",
    "metric",
    "metrics",
    "movers",
    "run",
    "summarize",
]
