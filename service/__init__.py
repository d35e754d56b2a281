"""The Bearing Twin service: store, live twin, jobs, alarms, web side, command line."""
