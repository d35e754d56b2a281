"""The cell: acquisition, live twins, limits and alarms."""
