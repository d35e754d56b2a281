"""Thermal networks that come with the product."""
