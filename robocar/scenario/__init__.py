"""Scenario files: their models and validation, and the scene that they describe."""

from robocar.scenario.load import find_scenario, load_scenario, scenario_names
from robocar.scenario.model import Scenario

__all__ = ["Scenario", "find_scenario", "load_scenario", "scenario_names"]
