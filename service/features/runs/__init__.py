"""Runs of a machine: listed, named, annotated, reported."""
