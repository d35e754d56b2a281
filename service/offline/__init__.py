"""Identification and forecasts from files, without a running service."""
