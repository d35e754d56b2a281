"""The demo: a virtual bench, the whole service on its wires, reported and scored."""
