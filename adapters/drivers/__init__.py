"""The drivers: one folder each, and one line each in ``adapters/registry.py``."""
