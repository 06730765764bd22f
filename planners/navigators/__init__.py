"""Whole navigators made of planners and controllers, and what they do when they are stuck."""
