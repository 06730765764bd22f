"""The files of one run: written beside their place and renamed when complete."""

from __future__ import annotations

import glob
import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from robocar.core import OutputError
from robocar.episode.fingerprint import fingerprint, versions
from robocar.scenario.model import Scenario


def run_name(scenario: str, chosen: Mapping[str, str], seed: int, settings: Mapping[str, Any]) -> str:
    """`<scenario>--<navigator>--<estimator>--<mapper>--s<seed>[--<8 hex of the overrides>]`: the name of a run's directory."""
    parts = [scenario, chosen["navigator"], chosen["estimator"], chosen["mapper"], f"s{seed}"]
    if settings:
        text = json.dumps(dict(sorted(settings.items())), sort_keys=True, default=str)
        parts.append(hashlib.sha256(text.encode()).hexdigest()[:8])
    return "--".join(part.replace("/", "_").replace(":", "_") for part in parts)


class RunDirectory:
    """The files of one run: written beside their place and renamed when complete, so a broken run never looks whole.

    `path` is where to write; a run that ends by an exception leaves nothing but what `path` then holds (a recording, say), under
    a name that starts with a dot and ends with `.partial`.
    """

    def __init__(
        self,
        out: str | Path,
        scenario: Scenario,
        chosen: Mapping[str, str],
        seed: int,
        settings: Mapping[str, Any],
        force: bool,
    ) -> None:
        self.name = run_name(scenario.name, chosen, seed, settings)
        self.final = Path(out) / self.name
        self.path = Path(out) / f".{self.name}.{os.getpid()}.partial"
        self._force = force
        plain = json.loads(json.dumps(dict(settings), default=str))  # whatever Python was handed, YAML can hold
        self._config = {
            "scenario": scenario.model_dump(mode="json"),
            "folder": str(scenario.folder),  # where the scenario's files are looked for
            **dict(chosen),
            "seed": seed,
            "settings": plain,
            "versions": versions(),
            "fingerprint": fingerprint(),
        }

    def __enter__(self) -> RunDirectory:
        try:
            if self.final.exists() and not self._force:
                raise OutputError(f"{self.final}: this run exists already; --force replaces it")
            shutil.rmtree(self.path, ignore_errors=True)  # of a killed process that had our number
            self.path.mkdir(parents=True)
            (self.path / "config.yaml").write_text(yaml.safe_dump(self._config, sort_keys=False))
        except OSError as error:
            raise OutputError(f"{self.final.parent}: cannot write a run here: {error.strerror or error}") from error
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None and not (self.path / "run.rrd").is_file():
            shutil.rmtree(self.path, ignore_errors=True)  # it had not begun: nothing to look into
        if isinstance(error, OSError):
            raise OutputError(f"{self.path}: cannot write: {error.strerror or error}") from error

    @staticmethod
    def clear(out: Path, name: str) -> None:
        """Removes half-written directories of this run, of processes that were killed; none may be at work on it."""
        for pattern in ("partial", "replaced"):
            for left in out.glob(f".{glob.escape(name)}.*.{pattern}"):
                shutil.rmtree(left, ignore_errors=True)

    def complete(self) -> Path:
        """Everything is written: give the directory its name.

        Raises:
            OSError: another process has finished the same run meanwhile, and nobody asked to replace it.
        """
        if self._force and self.final.exists():
            old = self.final.with_name(f".{self.name}.{os.getpid()}.replaced")
            os.rename(self.final, old)
            os.rename(self.path, self.final)
            shutil.rmtree(old)
        else:
            os.rename(self.path, self.final)
        return self.final
