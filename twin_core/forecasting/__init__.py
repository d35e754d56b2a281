"""Forecasts with honest intervals, and the naive ones that they must beat."""
