"""Identified models as functional mock-up units (FMI 2.0 and 3.0) for other programs."""
