"""Identification jobs: from low-risk windows in the store to a model version."""
