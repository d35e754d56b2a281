"""The Bearing Twin service: store, live twin, jobs, alarms, web side, command line."""

#: The only place that says it: packages, REST, OPC UA and `--version` take it from here.
__version__ = "1.0.0"
