"""Networks of machines that tests of several packages share."""

#: A winding in a body that a film cools, with parameters for all of it.
MOTOR = """
[parameters]
film = { unit = "W/K", centre = 8.0, spread = 0.3 }
joint = { unit = "K/W", centre = 0.06, spread = 0.4 }
speed = { unit = "W/rpm", centre = 0.16, spread = 0.5 }
torque = { unit = "W/N", centre = 0.16, spread = 0.5 }
[nodes]
t_winding_c = { capacity_j_k = 3000 }
t_body_c = { capacity_j_k = 40000 }
[[edges]]
between = ["t_winding_c", "t_body_c"]
kind = "constant"
resistance_k_w = "joint"
[[edges]]
between = ["t_body_c", "ambient"]
kind = "film"
conductance_w_k = "film"
exponent = 0.1
[source]
kind = "linear"
per_rpm_w = "speed"
per_n_w = "torque"
shares = [{ node = "t_winding_c", of_rest = 0.8 }, { node = "t_body_c" }]
[sensors]
t_winding_c = "t_winding_c"
[errors]
white_k = 0.5
slow_k = 0.6
[reference]
speed_rpm = 2500
load_n = 1500
"""
