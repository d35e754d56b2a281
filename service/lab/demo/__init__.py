"""The demo: a virtual bench, the whole service on its wires, a story told and scored."""
