"""Scenario files: their models and validation, and the scene that they describe."""
