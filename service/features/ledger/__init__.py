"""The forecast ledger: what was forecast, compared with what came."""
