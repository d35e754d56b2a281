"""Recorded data played as if they came now: tables (CSV, Parquet) and CAN logs (ASC, BLF)."""
