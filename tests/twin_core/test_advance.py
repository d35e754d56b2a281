"""Observers advanced together are as observers advanced one at a time."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from twin_core.bearings import bearing
from twin_core.models import ThermalModel, build_model
from twin_core.network import (
    Coefficient,
    Edge,
    EdgeKind,
    FrictionKind,
    HeatShare,
    HeatSource,
    Network,
    Node,
    Sensor,
    compile_network,
)
from twin_core.observer import Observation, Observer, advance
from twin_core.observers import Observers
from twin_core.parameters import Parameter, ParameterSet

MACHINES = 50
STEPS = 30


def motor() -> ThermalModel:
    """A winding in a cooled body: another network form, with inputs."""
    network = Network(
        "motor",
        (Node("t_winding_c", Coefficient(150.0)), Node("t_body_c", Coefficient(900.0))),
        (
            Edge("t_winding_c", "t_body_c", EdgeKind.CONSTANT, (Coefficient(1.0, "slot"),)),
            Edge("t_body_c", "ambient", EdgeKind.CONSTANT, (Coefficient(1.5),)),
            Edge("t_body_c", "coolant_c", EdgeKind.CONSTANT, (Coefficient(0.5),)),
            Edge(
                "t_winding_c",
                "current_a",
                EdgeKind.COPPER,
                (Coefficient(1.0, "r20"), Coefficient(0.004)),
            ),
        ),
        HeatSource(
            FrictionKind.LINEAR,
            (Coefficient(0.001), Coefficient(0.0), Coefficient(0.0)),
            "t_body_c",
            (HeatShare("t_body_c", Coefficient(1.0)),),
        ),
        (Sensor("t_mean_c", (("t_winding_c", 0.5), ("t_body_c", 0.5))),),
        ("coolant_c", "current_a"),
    )
    parameters = ParameterSet(
        (
            Parameter("slot", "-", "slot", "log", 0.2, 0.5),
            Parameter("r20", "-", "r20", "log", 0.05, 0.5),
        )
    )
    return ThermalModel(
        "motor",
        network,
        parameters,
        compile_network(network, parameters.names),
        "motor",
        reference_point=(3000.0, 1.0),
        reference_inputs=(25.0, 50.0),
    )


def values_of(model: ThermalModel, seed: int) -> np.ndarray:
    z = np.random.default_rng(seed).normal(0.0, 0.3, model.parameters.size)
    return np.asarray(model.parameters.values_from_z(z))


def begun(model: ThermalModel, seed: int) -> Observer:
    nodes = len(model.node_names)
    mean_c = np.random.default_rng(seed).normal(35.0, 2.0, nodes)
    return Observer(
        model, values_of(model, seed), mean_c, np.ones((nodes, nodes)) + np.eye(nodes), 1e4 * seed
    )


def models() -> list[ThermalModel]:
    """Of two forms; machines of one form do not all have the same model object."""
    objects = [build_model(bearing=bearing("6311")), motor()]
    objects += [build_model(bearing=bearing("6311")), motor()]
    return [objects[k % 4] for k in range(MACHINES)]


def random_step(rng: np.random.Generator, model: ThermalModel, machine: int) -> Observation:
    names = (*model.sensor_names, *model.node_names[:2])
    fitted = names if machine % 3 else names[:1]
    return Observation(
        float(rng.choice([0.0, 1.0, 5.0, 60.0, 300.0])),
        float(rng.uniform(-3000.0, 3000.0)),
        float(rng.uniform(-10.0, 4000.0)),
        float(rng.uniform(15.0, 30.0)),
        tuple(rng.uniform(20.0, 40.0, len(model.input_names)).tolist()),
        {name: float(rng.normal(35.0, 0.3)) for name in fitted if rng.random() < 0.7},
    )


def taken(observer: Observer, step: Observation) -> object:
    try:
        observer.predict(*step[:5])
        return observer.update(step.measured)
    except ValueError as error:
        return error


def assert_same(one: Observer, other: Observer) -> None:
    assert_allclose(one.temperatures_c, other.temperatures_c, rtol=0.0, atol=1e-9)
    assert_allclose(one.covariance, other.covariance, rtol=0.0, atol=1e-9)
    assert_allclose(one.heat_disturbance_w, other.heat_disturbance_w, rtol=0.0, atol=1e-9)
    assert one.revolutions == other.revolutions
    assert one.operating_point == other.operating_point
    assert one.model is other.model
    assert_allclose(one.to_dict()["covariance"], other.to_dict()["covariance"], atol=1e-9)


def test_fifty_machines_of_two_forms_are_as_fifty_alone() -> None:
    rng = np.random.default_rng(11)
    together = [begun(model, k) for k, model in enumerate(models())]
    alone = [begun(one.model, k) for k, one in enumerate(together)]
    failures = 0
    for number in range(STEPS):
        chosen = [k for k in range(MACHINES) if rng.random() < 0.9]
        steps = [random_step(rng, together[k].model, k) for k in chosen]
        for place, change in (
            (3, {"dt_s": 60.0, "ambient_c": 1e9}),
            (7, {"measured": {"t_nothing_c": 30.0}}),
            (8, {"measured": {"t_inner_ring_c": np.nan}}),
            (9, {"dt_s": -1.0}),
            (11, {"load_n": np.inf}),
            (12, {"inputs": (1.0, 2.0, 3.0)}),
        ):
            if rng.random() < 0.3:
                steps[place] = steps[place]._replace(**change)
        found = advance([together[k] for k in chosen], steps)
        for k, step, result in zip(chosen, steps, found, strict=True):
            expected = taken(alone[k], step)
            if isinstance(expected, ValueError):
                failures += 1
                assert (type(result), str(result)) == (type(expected), str(expected))
            else:
                assert isinstance(result, dict)
                assert result.keys() == expected.keys()
                for name, innovation in result.items():
                    assert_allclose(innovation, expected[name], rtol=0.0, atol=1e-9)
        if number % 10 == 5:
            for k in range(0, MACHINES, 7):
                for many in (together, alone):
                    many[k] = many[k].with_parameters(many[k].model, values_of(many[k].model, 99))
        if number % 10 == 8:
            for k in range(0, MACHINES, 6):
                for many in (together, alone):
                    kept = json.loads(json.dumps(many[k].to_dict()))
                    many[k] = Observer.from_dict(many[k].model, many[k].values, kept)
        for many in (together, alone):
            many[number].renew_grease()
            many[4].predict(2.0, 1500.0, 1000.0, 22.0)
            many[4].update({"t_outer_ring_c": 44.0})
    assert failures > STEPS
    for one, other in zip(together, alone, strict=True):
        assert_same(one, other)


def test_a_machine_that_runs_away_is_left_as_it_was_and_the_others_go_on() -> None:
    many = [begun(build_model(bearing=bearing("6311")), k) for k in range(3)]
    usual = Observation(60.0, 2000.0, 1000.0, 20.0, (), {"t_inner_ring_c": 50.0})
    advance(many, [usual] * 3)
    before = [one.to_dict() for one in many]
    found = advance(many, [usual, usual._replace(ambient_c=1e9), usual])
    assert [isinstance(result, dict) for result in found] == [True, False, True]
    assert "ran away at 2000 rpm" in str(found[1])
    assert [one.to_dict() == kept for one, kept in zip(many, before, strict=True)] == [
        False,
        True,
        False,
    ]


def test_machines_of_one_form_cost_one_call(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = []
    real = Observers.advance

    def counted(self: Observers, *args: np.ndarray) -> np.ndarray:
        sizes.append(self.size)
        return real(self, *args)

    monkeypatch.setattr(Observers, "advance", counted)
    many = [begun(model, k) for k, model in enumerate(models()[:8])]
    steps = [
        Observation(1.0, 2000.0, 1000.0, 20.0, (25.0, 5.0) if k % 2 else (), {}) for k in range(8)
    ]
    advance(many, steps)
    advance(many, steps)
    # Where some have nothing to do, the others still need no copy.
    advance(many[:6], steps[:6])
    assert sizes == [4] * 6


def test_other_parameters_of_a_bearing_are_another_form() -> None:
    """The factors of its network are not those of a machine but of the form."""
    small, large = build_model(bearing=bearing("6016")), build_model(bearing=bearing("6311"))
    step = Observation(60.0, 2000.0, 1000.0, 20.0, (), {"t_inner_ring_c": 50.0})
    together, alone = ([begun(small, 1), begun(large, 2)] for _ in range(2))
    advance(together, [step, step])
    for one, other in zip(together, alone, strict=True):
        taken(other, step)
        assert_same(one, other)
