"""Scenarios that are wrong say what is wrong: every message names the field, the value, and where possible what was meant.

Oracles: the messages the design promises; closed forms for what fits beside a wall.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from robocar.core import GoalOccupied, MapFormatError, OutsideMap, RobocarError, ScenarioError, StartOccupied
from robocar.paths import MODELS
from robocar.scenario.load import load_scenario
from robocar.scenario.model import Scenario
from robocar.scenario.scene import Scene
from robocar.sim.robot_model import RobotModel

FEET = RobotModel.load().footprint
TRAP: dict[str, Any] = {"map": "maps/u_trap.yaml", "start": [0.8, 3.0, 0], "goal": [5.2, 3.0]}
CART: dict[str, Any] = {"name": "cart", "cylinder": [0.2, 0.5], "waypoints": [[1, 1], [5, 1]]}


def scene_of(**changes: Any) -> Scene:
    """The scene of the U trap with some keys changed; None drops a key."""
    content = {key: value for key, value in (TRAP | changes).items() if value is not None}
    return Scene.load(load_scenario(content), FEET)


class TestBadFields:
    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"gaol": [1, 2]}, r"unknown key 'gaol' \(did you mean 'goal'\?\)"),
            ({"robot": {"lidr": "hokuyo"}}, r"unknown key 'robot.lidr' \(did you mean 'lidar'\?\)"),
            (
                {"robot": {"sensors": {"sonar": {"perod": 0.1}}}},
                "'robot.sensors.sonar.perod' .*'period'",
            ),
            ({"unknown_obstacles": [{"bx": [1, 1, 1], "pose": [1, 1, 0]}]}, r"unknown key 'unknown_obstacles.0.bx' .*'box'"),
            ({"movers": [CART | {"sped": 1}]}, r"unknown key 'movers.0.sped' \(did you mean 'speed'\?\)"),
            ({"map": None}, "missing key 'map'"),
            ({"start": None}, "missing key 'start'"),
            ({"time_limit": "soon"}, r"time_limit: .*number.*'soon'"),
            ({"time_limit": True}, "time_limit: expected a number, not True"),
            ({"start": "here"}, "start: .*'here'"),
            ({"start": [1, 2]}, "start: number 3 is missing"),
            ({"goal": [1, 2, 3, 4]}, "goal: at most 3 numbers"),
            ({"goal": [1, "east"]}, "goal.1: .*'east'"),
            ({"start": [math.nan, 0, 0]}, "start.0: .*nan"),
            ({"goal": [0, math.inf]}, "goal.1: .*inf"),
            ({"resolution": math.nan}, "resolution: .*nan"),
            ({"time_limit": -1}, "time_limit: .*greater than 0, not -1"),
            ({"xy_goal_tolerance": 0}, "xy_goal_tolerance: .*greater than 0"),
            ({"wall_height": math.inf}, "wall_height: .*inf"),
            ({"events": [{"time": -1, "kidnap": [1, 1, 0]}]}, "events.0.time: .*-1"),
            ({"events": [{"time": math.inf, "kidnap": [1, 1, 0]}]}, "events.0.time: .*inf"),
            ({"robot": {"sensors": {"sonar": {"period": 0}}}}, "robot.sensors: sonar.period: .*above 0"),
            ({"robot": {"sensors": {"lidar": {"range_std": -0.1}}}}, "robot.sensors: lidar.range_std: .*from 0 on"),
            ({"robot": {"sensors": {"sonar": {"dropout": 1.5}}}}, "robot.sensors: sonar.dropout: .*0 to 1"),
            ({"robot": {"physics": {"timestep": math.nan}}}, "robot.physics: timestep: .*nan"),
            ({"robot": {"lidar": "velodyne"}}, "robot.lidar: .*'none', 'hokuyo' or 'scan360', not 'velodyne'"),
            ({"lighting": "dark"}, "lighting: .*'default', 'dim' or 'bright', not 'dark'"),
            ({"landmarks": [{"color": "pink", "position": [1, 1]}]}, "landmarks.0.color: .*'magenta' or 'cyan', not 'pink'"),
            ({"landmarks": [{"color": "red", "position": [1, 1], "name": "a"}] * 2}, "landmarks need different names"),
            ({"unknown_obstacles": [{"box": [1, 1, -1], "pose": [1, 1, 0]}]}, "unknown_obstacles.0.box.2: .*greater than 0"),
            ({"unknown_obstacles": [{"pose": [1, 1, 0]}]}, "unknown_obstacles.0: give either box"),
            ({"movers": [CART, CART]}, r"movers need different names, not \['cart', 'cart'\]"),
            ({"movers": [CART | {"box": [1, 1, 1]}]}, "movers.0: give either box"),
            ({"movers": [CART | {"speed": -0.1}]}, "movers.0.speed: .*-0.1"),
            ({"movers": [CART | {"waypoints": []}]}, "movers.0.waypoints"),
            ({"movers": [CART | {"motion": "stop-and-go"}]}, "movers.0.motion: .*stop-turn-go.*, not 'stop-and-go'"),
            ({"movers": [CART | {"pause": 2.0}]}, "movers.0: pause is of no use to motion constant, only to stop-turn-go or"),
            ({"movers": [CART | {"motion": "stop-turn-go", "roam": 2.0}]}, "roam is of no use to motion stop-turn-go"),
            ({"movers": [CART | {"motion": "random-walk"}]}, "movers.0: a random-walk takes one way point, its start, not 2"),
            ({"movers": [CART | {"motion": "stop-turn-go", "speed": 0}]}, "movers.0: speed 0 leads nowhere"),
            ({"movers": [CART | {"motion": "stop-turn-go", "turn_speed": 0}]}, "movers.0.turn_speed: .*not 0"),
            ({"success_radius": 0.05}, r"success_radius \(0.05\) must not be smaller than xy_goal_tolerance"),
        ],
    )
    def test_the_message_names_the_field(self, changes: dict[str, Any], message: str) -> None:
        with pytest.raises(ScenarioError, match=message):
            scene_of(**changes)

    def test_each_bad_number_of_a_goal_is_reported_once(self) -> None:
        with pytest.raises(ScenarioError) as caught:
            scene_of(goal=[1, "east"])
        assert str(caught.value).count("goal") == 1

    @given(key=st.sampled_from(sorted(set(Scenario.model_fields) - {"folder", "map"})), at=st.integers(0, 20))
    def test_a_key_with_a_letter_lost_is_refused_with_the_key_that_was_meant(self, key: str, at: int) -> None:
        spelled = key[: at % len(key)] + key[at % len(key) + 1 :]
        with pytest.raises(ScenarioError, match=f"unknown key {spelled!r}.*did you mean '"):
            load_scenario(TRAP | {spelled: 1})

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("map: [a", "line [12].*not YAML"),
            ("- a\n- b\n", "mapping of keys to values, not list"),
            ("", "mapping of keys to values, not NoneType"),
            ("map: a.yaml\nstart: [0, 0, 0]\nfolder: /\n", "unknown key 'folder'"),
        ],
    )
    def test_files_that_are_no_scenario(self, text: str, message: str, tmp_path: Path) -> None:
        file = tmp_path / "bad.yaml"
        file.write_text(text)
        with pytest.raises(ScenarioError, match=message) as caught:
            load_scenario(file)
        assert "bad.yaml" in str(caught.value)

    def test_a_name_that_does_not_exist_lists_those_that_do(self) -> None:
        with pytest.raises(ScenarioError, match=r"'thesis-feild' \(did you mean 'thesis-field'\?\); known: .*warehouse"):
            load_scenario("thesis-feild")

    def test_a_scenario_written_out_and_read_again_is_the_same(self, tmp_path: Path) -> None:
        first = load_scenario("warehouse")
        file = tmp_path / "copy.yaml"
        file.write_text(yaml.safe_dump(first.model_dump(mode="json")))
        assert load_scenario(file).model_dump() == first.model_dump()


class TestBadPlaces:
    @pytest.mark.parametrize(
        ("changes", "error", "message"),
        [
            ({"map": "maps/nowhere.yaml"}, ScenarioError, "map: there is no file 'maps/nowhere.yaml'"),
            ({"prior": "maps/nowhere.yaml"}, ScenarioError, "prior: there is no file 'maps/nowhere.yaml'"),
            ({"start": [3.7, 3.0, 0]}, StartOccupied, r"start \(3.7, 3, 0\) lies in a wall"),
            ({"start": [-1.0, 3.0, 0]}, OutsideMap, r"start \(-1.000, 3.000\) lies outside the map, .*x 0.000 to 6.000"),
            ({"start": [0.22, 3.0, 0.785]}, StartOccupied, "start .* is too tight: the car's footprint touches"),
            ({"goal": [3.7, 3.0]}, GoalOccupied, r"goal \(3.7, 3\) lies in a wall of the prior map"),
            ({"goal": [3.7, 3.0], "prior": "none"}, GoalOccupied, r"goal \(3.7, 3\) lies in a wall of the map"),
            ({"goal": [9.0, 3.0]}, OutsideMap, r"goal \(9.000, 3.000\) lies outside the map"),
            ({"goal": [5.85, 3.0]}, GoalOccupied, "goal .* is too tight: .* is 0.050 m away, the car needs 0.090 m"),
            ({"events": [{"time": 5, "kidnap": [3.7, 3, 0]}]}, ScenarioError, r"kidnap at 5 s \(3.7, 3, 0\) lies in a wall"),
            ({"events": [{"time": 5, "kidnap": [7, 3, 0]}]}, OutsideMap, "kidnap at 5 s .* lies outside the map"),
        ],
    )
    def test_the_message_names_place_and_reason(self, changes: dict[str, Any], error: type[RobocarError], message: str) -> None:
        with pytest.raises(error, match=message):
            scene_of(**changes)

    def test_unknown_obstacles_count_for_start_goal_and_the_map(self) -> None:
        block = {"box": [0.3, 0.3, 0.2]}
        with pytest.raises(StartOccupied, match="too tight"):
            scene_of(unknown_obstacles=[block | {"pose": [0.8, 3.0, 0]}])
        with pytest.raises(GoalOccupied, match="unknown obstacle"):
            scene_of(unknown_obstacles=[block | {"pose": [5.2, 3.0, 0]}])
        with pytest.raises(OutsideMap, match=r"unknown_obstacles\.1 "):
            scene_of(unknown_obstacles=[block | {"pose": [1, 1, 0]}, block | {"pose": [9, 9, 0]}])

    def test_a_goal_that_may_be_blocked_is_let_pass(self) -> None:
        assert scene_of(goal=[3.7, 3.0], goal_may_be_blocked=True).grid.occupied[60, 74]

    def test_a_map_whose_image_is_missing_is_named(self, tmp_path: Path) -> None:
        (tmp_path / "m.yaml").write_bytes((MODELS / "maps" / "u_trap.yaml").read_bytes())
        with pytest.raises(MapFormatError, match=r"u_trap\.pgm"):
            scene_of(map=str(tmp_path / "m.yaml"))

    @given(theta=st.floats(-math.pi, math.pi), gap=st.floats(0.01, 0.09))
    def test_start_beside_a_wall_fits_exactly_where_no_corner_reaches_it(self, theta: float, gap: float) -> None:
        """Analytic: the western wall ends at x = 0.1, and the nearest corner is |0.10 cos| + |0.09 sin| from the centre."""
        reach = 0.10 * abs(math.cos(theta)) + 0.09 * abs(math.sin(theta))
        assert FEET.circumscribed_radius == pytest.approx(math.hypot(0.10, 0.09))
        scene_of(start=[0.1 + reach + gap, 3.0, theta])
        with pytest.raises(StartOccupied, match="start"):
            scene_of(start=[0.1 + reach - gap, 3.0, theta])


class TestMovers:
    def test_on_free_floor_they_are_taken(self) -> None:
        (mover,) = scene_of(movers=[CART]).movers
        assert (mover.start.x, mover.start.y) == (1, 1)

    @pytest.mark.parametrize(
        ("waypoints", "leg"),
        [
            ([[1, 1], [5, 1], [5, 5], [2.5, 5], [2.5, 3]], r"\(2.5, 5\) and \(2.5, 3\)"),  # through the U's upper arm
            ([[2.5, 3], [1, 3], [1, 5], [2.5, 5]], r"\(2.5, 5\) and \(2.5, 3\)"),  # only the way back does
            ([[1, 1], [9, 1]], r"\(1, 1\) and \(9, 1\)"),  # through the border
            ([[1, 0.25], [5, 0.25]], r"\(1, 0.25\) and \(5, 0.25\)"),  # its centre is free, its side is not
            ([[3.7, 3]], r"\(3.7, 3\) and \(3.7, 3\)"),  # stands in a wall
        ],
    )
    def test_through_a_wall_the_message_names_mover_and_leg(self, waypoints: list[list[float]], leg: str) -> None:
        with pytest.raises(ScenarioError, match=f"mover 'cart' hits a wall or an obstacle between {leg}"):
            scene_of(start=[0.8, 2.0, 0], movers=[CART | {"waypoints": waypoints}])

    def test_through_an_unknown_obstacle_far_along_the_way(self) -> None:
        post = [{"cylinder": [0.1, 0.3], "pose": [4.5, 0.8, 0]}]
        with pytest.raises(ScenarioError, match="mover 'cart' hits"):
            scene_of(movers=[CART], unknown_obstacles=post)

    def test_one_that_turns_needs_room_to_turn(self) -> None:
        """A box of 1.2 x 0.2 m beside the western wall at x = 0.1: up and down it fits at x = 0.25, turning about it does not."""
        box = {"name": "cart", "box": [1.2, 0.2, 0.3], "heading": math.pi / 2, "waypoints": [[0.25, 1.0], [0.25, 2.0]]}
        (mover,) = scene_of(start=[3.0, 0.8, 0], movers=[box]).movers
        assert mover.start.theta == math.pi / 2
        with pytest.raises(ScenarioError, match=r"mover 'cart' hits .* between \(0.25, 2\) and \(0.25, 2\)"):
            scene_of(start=[3.0, 0.8, 0], movers=[box | {"motion": "stop-turn-go"}])
        walk = {"motion": "random-walk", "waypoints": [[0.25, 1.0]]}
        with pytest.raises(ScenarioError, match=r"mover 'cart' hits .* between \(0.25, 1\) and \(0.25, 1\)"):
            scene_of(start=[3.0, 0.8, 0], movers=[box | walk])

    def test_one_that_turns_looks_towards_its_second_way_point(self) -> None:
        (mover,) = scene_of(movers=[CART | {"motion": "stop-turn-go", "waypoints": [[2, 1], [1, 1]]}]).movers
        assert mover.start.theta == math.pi
        assert (mover.pause, mover.turn_speed) == (1.0, 1.0)

    def test_where_the_car_starts(self) -> None:
        with pytest.raises(ScenarioError, match=r"mover 'cart' stands at \(0.9, 3\), where the car starts"):
            scene_of(movers=[CART | {"waypoints": [[0.9, 3], [0.9, 5]]}])

    def test_outside_the_map(self) -> None:
        with pytest.raises(OutsideMap, match="mover 'cart' at its start"):
            scene_of(movers=[CART | {"waypoints": [[9, 9]]}])

    @given(y=st.floats(0.12, 1.48), radius=st.floats(0.02, 0.4))
    def test_a_disc_passes_below_the_trap_exactly_where_it_fits(self, y: float, radius: float) -> None:
        """Analytic: the floor between the southern wall, up to y = 0.1, and the U, from y = 1.5."""
        fits = min(y - 0.1, 1.5 - y) - radius
        mover = CART | {"cylinder": [radius, 0.3], "waypoints": [[1.0, y], [5.0, y]]}
        try:
            scene_of(movers=[mover])
            passed = True
        except ScenarioError:
            passed = False
        assert passed == (fits > 0) or abs(fits) < 1e-9
