"""Tolerances of a comparison: those that the metrics declare, with a suite's changes."""

from __future__ import annotations

from collections.abc import Mapping

from robocar.metrics import Tolerance, declared

_NOT_JUDGED = Tolerance("neither")


def tolerances(changes: Mapping[str, Mapping[str, object]] | None = None) -> dict[str, Tolerance]:
    """By metric: as declared, with the given fields changed, `{"duration": {"relative": 0.1}}`.

    A metric that nobody has declared here is listed and not judged, unless a change says how.

    Raises:
        ValueError: a field that no tolerance has, or a bad value.
    """
    table = {name: declaration.tolerance for name, declaration in declared().items()}
    for metric, fields in (changes or {}).items():
        old = table.get(metric, _NOT_JUDGED)
        known = {"better": old.better, "absolute": old.absolute, "relative": old.relative}
        unknown = sorted(set(fields) - set(known))
        if unknown:
            raise ValueError(f"tolerance of {metric}: unknown field {unknown[0]!r}; it has better, absolute, relative")
        table[metric] = Tolerance(**{**known, **fields})  # type: ignore[arg-type]
    return table
