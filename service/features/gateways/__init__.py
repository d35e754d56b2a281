"""Pushes of gateways that speak for many assets."""
