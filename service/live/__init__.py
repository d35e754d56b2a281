"""The live side of the service: one runtime per asset, and the bus that tells of its changes."""
