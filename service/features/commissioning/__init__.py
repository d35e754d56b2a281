"""A bench is put into service from the page."""
