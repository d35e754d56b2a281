"""Nights: all machines of a fleet are identified again, each once a night."""
