"""CAN with a DBC file: a listening driver over any python-can interface."""
