from dataclasses import replace

import numpy as np

from twin_core.bearings import bearing
from twin_core.models import build_model
from twin_core.network import Sensor
from twin_core.process_noise import (
    between_joints,
    hidden_spread,
    joint_variance,
    reading_errors,
)


def test_hidden_nodes_may_deviate_where_no_sensor_would_show_it() -> None:
    model = build_model(bearing=bearing("6311"))
    spread = hidden_spread(model, model.parameters.centre)
    sensors = model.sensor_matrix(model.sensor_names) @ spread
    assert np.linalg.norm(sensors, axis=1).max() < 0.005
    nodes = dict(zip(model.node_names, np.linalg.norm(spread, axis=1), strict=True))
    # K per kelvin of the sensors' mean rise: balls and shaft ends hang loosely on the rings.
    assert 0.1 < nodes["t_node_3_c"] < 0.6
    assert 0.03 < nodes["t_node_12_c"] < 0.3
    assert nodes["t_node_4_c"] < 0.01


def test_sleeves_and_cage_hang_between_joints_unless_a_sensor_sits_on_them() -> None:
    model = build_model(bearing=bearing("6311"))
    bodies, neighbours = between_joints(model)
    pairs = {(body + 1, other + 1) for body, other in zip(bodies, neighbours, strict=True)}
    assert pairs == {(6, 3), (6, 7), (10, 4), (10, 5), (11, 4), (11, 12)}

    sensor = Sensor("t_sleeve_c", (("t_node_10_c", 1.0),))
    network = replace(model.network, sensors=(*model.network.sensors, sensor))
    bodies, _ = between_joints(replace(model, network=network))
    assert set((bodies + 1).tolist()) == {6, 11}


def test_a_body_between_joints_is_as_doubtful_as_its_neighbours_are_apart() -> None:
    joints = between_joints(build_model(bearing=bearing("6311")))
    paths_c = np.full((2, 13), 40.0)
    paths_c[1, 3] = 52.0  # the inner ring, to which both sleeves are joined
    variance = joint_variance(joints, paths_c)
    assert not variance[0].any()
    expected = np.zeros(13)
    expected[[9, 10]] = (12.0 / 2.0) ** 2
    np.testing.assert_allclose(variance[1], expected)


def test_a_reading_of_a_body_between_joints_weighs_as_little_as_its_place_is_known() -> None:
    model = build_model(bearing=bearing("6311"))
    usual = [
        *model.sensor_names,
        *(name for k, name in enumerate(model.node_names, 1) if k not in (10, 11)),
    ]
    found = reading_errors(model, [*usual, "t_node_10_c", "t_node_11_c"])
    assert all(found[name] is model.errors for name in usual)
    # The right sleeve hangs between the ring and the colder end of the shaft.
    assert 1.0 < found["t_node_10_c"].slow_k < found["t_node_11_c"].slow_k < 10.0
    assert replace(found["t_node_10_c"], slow_k=model.errors.slow_k) == model.errors
    sensor = Sensor("t_sleeve_c", (("t_node_10_c", 1.0),))
    network = replace(model.network, sensors=(*model.network.sensors, sensor))
    told = reading_errors(replace(model, network=network), ["t_sleeve_c", "t_node_10_c"])
    assert set(told.values()) == {model.errors}, "a standard sensor is taken at its word"
