"""Every answer and message, once: the model that builds it also publishes its schema."""
