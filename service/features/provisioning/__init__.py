"""Assets are made, changed and removed while the service runs."""
