"""Drift: whether a machine has changed between the data of several model versions."""
