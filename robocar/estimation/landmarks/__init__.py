"""Localization by landmarks that a camera sees."""
