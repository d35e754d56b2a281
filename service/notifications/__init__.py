"""Alarms by e-mail and webhook: who is told what, how often, and when."""
