"""What the processes of a service tell each other."""
