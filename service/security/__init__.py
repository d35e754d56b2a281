"""Who may do what: keys, browser sessions and roles."""
