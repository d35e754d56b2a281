"""Which low-risk step teaches most about a planned point."""
