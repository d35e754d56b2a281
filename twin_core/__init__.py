"""The virtual model of a rolling bearing: pure computation, no I/O, no clock."""
