"""Equal seeds give equal runs, whatever else is recorded, sensed or imported, and wherever they run.

Oracles: hashes and trajectories of repeated runs; SHA-256 over the states.
"""

from __future__ import annotations

import hashlib
import math
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import yaml

from robocar.core import STOP, Drive, Observation, Twist
from robocar.episode.result import RunResult
from robocar.episode.run import run, simulate
from robocar.reporting.run_many import run_many
from robocar.scenario.load import load_scenario
from tests.episode.runs import PARTS, SHORT


class TestDeterminism:
    def test_the_same_with_and_without_recording(self, recorded: RunResult) -> None:
        again = run(SHORT, **PARTS, seed=3)
        assert again.hash == recorded.hash
        for name in ("truth", "estimate", "odometry"):
            assert np.array_equal(getattr(again, name).poses, getattr(recorded, name).poses)

    def test_the_same_in_worker_processes(self, recorded: RunResult) -> None:
        job = {"scenario": SHORT, **PARTS, "seed": 3}
        first, second = run_many([job, job | {"seed": 4}])
        assert first.hash == recorded.hash != second.hash

    def test_another_seed_is_another_run(self, recorded: RunResult) -> None:
        hashes = {run(SHORT, **PARTS, seed=seed).hash for seed in (0, 1, 2)} | {recorded.hash}
        assert len(hashes) == 4

    def test_the_hash_is_sha256_over_time_qpos_qvel_and_ctrl_at_each_tick(self) -> None:
        world = simulate(SHORT, seed=5)
        digest = hashlib.sha256()
        for tick in range(60):
            world.robot.sense()
            world.robot.act(Drive(Twist(0.2, 0.3 * math.sin(tick))))
            world.step()
            data = world.data
            for part in (np.float64(data.time), data.qpos, data.qvel, data.ctrl):
                digest.update(np.asarray(part, dtype=np.float64).tobytes())
        assert world.hash == digest.hexdigest()
        world.close()

    def test_a_run_does_not_touch_the_global_random_state(self) -> None:
        np.random.seed(1)  # noqa: NPY002
        expected = np.random.random()  # noqa: NPY002
        np.random.seed(1)  # noqa: NPY002
        run(SHORT, **PARTS, seed=1, settings={"time_limit": 1})
        assert np.random.random() == expected  # noqa: NPY002

    @pytest.mark.parametrize("more", [{"robot.compass": True}, {"robot.lidar": "scan360"}])
    def test_one_more_sensor_changes_no_other_stream(self, more: dict[str, Any]) -> None:
        """A parked car: what the sonars, the PSD and the accelerometer say is the same, noise and drop-outs included."""

        def readings(settings: dict[str, Any], seed: int = 7) -> np.ndarray:
            world = simulate(SHORT, seed=seed, settings=settings)
            rows = []
            for _ in range(60):
                seen: Observation = world.robot.sense()
                world.robot.act(STOP)
                world.step()
                rows += [[scan.time, *scan.ranges] for scan in seen.sonars]
                rows += [[r.time, r.value] for r in (seen.psd,) if r is not None]
                rows += [[r.time, v] for r in (seen.acceleration,) if r is not None for v in r.value]
            world.close()
            return np.array(rows)

        plain = readings({})
        assert len(plain) > 100
        assert np.array_equal(readings(more), plain, equal_nan=True)
        assert not np.array_equal(readings({}, seed=8), plain, equal_nan=True)

    def test_the_effective_configuration_gives_the_run_again(self, recorded: RunResult) -> None:
        assert recorded.directory is not None
        config = yaml.safe_load((recorded.directory / "config.yaml").read_text())
        parts = {kind: config[kind] for kind in ("navigator", "estimator", "mapper")}
        again = run(config["scenario"], **parts, seed=config["seed"])
        assert again.hash == recorded.hash

    def test_a_scenario_object_a_mapping_and_overrides_mean_the_same(self, recorded: RunResult) -> None:
        other = {key: value for key, value in SHORT.items() if key != "goal"}
        assert run(other, **PARTS, seed=3, settings={"goal": [1.2, 0.4]}).hash == recorded.hash
        assert run(load_scenario(SHORT), **PARTS, seed=3).hash == recorded.hash


def test_the_function_run_stays_the_function() -> None:
    """`robocar.run` is the API's function, whatever else is imported before or after it."""
    call = "\ntry: robocar.run('none')\nexcept robocar.core.ScenarioError: pass\nelse: raise AssertionError"
    for order in (
        "import robocar.episode.run, robocar",
        "import robocar; robocar.run; robocar.RunResult; import robocar.episode.run",
    ):
        subprocess.run([sys.executable, "-c", f"{order}; import robocar.core{call}"], check=True)
