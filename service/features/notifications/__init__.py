"""Alarms by e-mail and webhook."""
