"""The inputs of a verdict, and the ways in which each can be missing."""

WARM = {
    "speed_rpm": 1500.0,
    "load_n": 2650.0,
    "ambient_c": 23.0,
    "t_inner_ring_c": 36.0,
    "t_outer_ring_c": 30.0,
}
INPUTS = tuple(WARM)
RING = "t_inner_ring_c"
HOUR_US = 3_600_000_000
WAYS = ("good", "bad", "uncertain", "stale", "never")
