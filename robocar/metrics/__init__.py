"""What a run is judged by: the run itself, its map, its movers, its localization."""

from robocar.metrics.run import Metric, RunLog, summarize

__all__ = ["Metric", "RunLog", "summarize"]
