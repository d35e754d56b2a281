"""A whole fleet on one machine: its parts are killed one by one, and a ledger outside counts."""
