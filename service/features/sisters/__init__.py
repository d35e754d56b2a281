"""Sisters: machines of one family teach each other where each has been."""
