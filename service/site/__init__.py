"""The configuration of a site: settings, sources, channels, machines."""
