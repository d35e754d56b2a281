"""Planned times without notifications of alarms."""
