"""Puts cell, web side and plant side together, starts and watches them."""
