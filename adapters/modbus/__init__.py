"""Modbus TCP: a polling driver that never turns a doubtful answer into a good value."""
