"""Benchmarks: how fast the product is, with what it is measured against in the same run."""
