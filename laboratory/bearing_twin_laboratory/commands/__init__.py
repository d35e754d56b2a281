"""Commands that the command line finds by entry points."""
