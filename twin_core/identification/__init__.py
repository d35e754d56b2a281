"""Parameters of the thermal network from measured low-risk windows."""
