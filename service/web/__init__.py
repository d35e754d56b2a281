"""The web side: REST, stream and pages."""
