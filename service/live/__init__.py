"""The live side of the service: one runtime per asset, and the live messages of its changes."""
