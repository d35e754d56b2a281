"""The laws are written twice, in Python and in C: both say the same of any input."""

import ctypes
from collections.abc import Iterator
from importlib import resources

import numpy as np
import pytest
from programs import needed

from service.offline.fmu import tables
from service.offline.fmu.library import compile_library
from twin_core.network import COEFFICIENT_COUNT, LOSSES, EdgeKind, FrictionKind
from twin_core.simulation import laws

pytestmark = pytest.mark.wires

# All but what the compilers may do: hidden symbols are shown, to be called here.
_OPTIONS = ("-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC")
Numbers = ctypes.POINTER(ctypes.c_double)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    needed("gcc libc6-dev", "cc")
    folder = resources.files("service.offline.fmu") / "sources"
    sources = {name: (folder / name).read_bytes() for name in ("laws.c", "laws.h")}
    path = tmp_path_factory.mktemp("laws") / "laws.so"
    path.write_bytes(compile_library(sources, _OPTIONS))
    found = ctypes.CDLL(str(path))
    number, kind = ctypes.c_double, ctypes.c_int
    for name, arguments in (
        ("edge_conductance", [kind, Numbers, number, number, number]),
        ("loss_at_zero_w", [kind, Numbers, number, number]),
        ("running_in", [kind, Numbers, number]),
        ("heat_at_point_w", [kind, Numbers, number, number]),
        ("film_excess_w", [number, number, number]),
    ):
        function = getattr(found, name)
        function.restype, function.argtypes = number, arguments
    found.friction_at_point.argtypes = [kind, Numbers, number, number, Numbers]
    return found


def pointer(array: np.ndarray) -> object:
    return array.ctypes.data_as(Numbers)


def operating_points(seed: int, count: int = 2000) -> Iterator[tuple[float, float, float, float]]:
    """Speed, load, temperature, and a drive; standstill and limits come often."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        speed = float(rng.choice([0.0, 10.0, 300.0, 3000.0, 1e4 * rng.random(), 20 * rng.random()]))
        load = float(rng.choice([0.0, 50.0, 265.0, 2650.0, 1e4 * rng.random()]))
        yield speed, load, float(rng.uniform(-80.0, 300.0)), float(rng.uniform(-200.0, 200.0))


def test_the_numbers_of_the_kinds_are_the_same() -> None:
    header = (resources.files("service.offline.fmu") / "sources" / "laws.h").read_text()
    listed = [part.split("}")[0].replace("\n", " ") for part in header.split("enum {")[1:]]
    friction, edges = ([name.strip() for name in part.split(",")] for part in listed)
    assert friction == [kind.name for kind in tables.EXPORTED_FRICTION]
    assert edges == [kind.name for kind in tables.EXPORTED_EDGES]
    # All that can be simulated can be exported.
    assert tuple(FrictionKind) == tables.EXPORTED_FRICTION
    assert tuple(EdgeKind) == tables.EXPORTED_EDGES


@pytest.mark.parametrize("kind", EdgeKind)
def test_edges_and_losses(library: ctypes.CDLL, kind: EdgeKind) -> None:
    rng = np.random.default_rng(int(kind))
    for speed, load, _, driving in operating_points(int(kind)):
        c = np.zeros(4)
        c[: COEFFICIENT_COUNT[kind]] = rng.uniform(0.05, 3.0, COEFFICIENT_COUNT[kind])
        ours = laws.edge_conductance(int(kind), c, speed, load, driving)
        theirs = library.edge_conductance(int(kind), pointer(c), speed, load, driving)
        assert theirs == pytest.approx(ours, rel=1e-12, abs=1e-300)
        if kind in LOSSES:
            ours = laws.loss_at_zero_w(int(kind), c, speed, driving)
            theirs = library.loss_at_zero_w(int(kind), pointer(c), speed, driving)
            assert theirs == pytest.approx(ours, rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("kind", FrictionKind)
def test_friction(library: ctypes.CDLL, kind: FrictionKind) -> None:
    rng = np.random.default_rng(10 + int(kind))
    centres = {
        FrictionKind.PALMGREN: [1.0, 87.5, 45000.0, 100.0, 0.03, 40.0],
        FrictionKind.TWO_PART: [200.0, 0.24, -0.18, 0.38, -0.18, 0.14, 0.36, 1.6, 0.3, 1e6],
        FrictionKind.LINEAR: [0.05, 0.02, 3.0],
    }
    limited = 0
    for speed, load, temperature, _ in operating_points(20 + int(kind)):
        c = np.zeros(10)
        c[: len(centres[kind])] = centres[kind] * rng.uniform(0.3, 3.0, len(centres[kind]))
        c[5] = min(c[5], 0.9) if kind is FrictionKind.TWO_PART else c[5]
        if rng.random() < 0.1:
            c[8] = 0.0
        revolutions = float(rng.uniform(0.0, 3e6))
        ours = laws.friction_at_point(int(kind), c, speed, load)
        theirs = np.empty(5)
        library.friction_at_point(int(kind), pointer(c), speed, load, pointer(theirs))
        np.testing.assert_allclose(theirs, ours, rtol=1e-12, atol=1e-300)
        fresh = laws.running_in(int(kind), c, revolutions)
        assert library.running_in(int(kind), pointer(c), revolutions) == pytest.approx(
            fresh, rel=1e-12
        )
        heat_w = laws.heat_at_point_w(int(kind), ours, temperature, fresh)
        limited += heat_w == laws.HEAT_LIMIT_W
        assert library.heat_at_point_w(
            int(kind), pointer(ours), temperature, fresh
        ) == pytest.approx(heat_w, rel=1e-11, abs=1e-300)
    # The limit of a bearing that runs away was among them.
    assert kind is FrictionKind.LINEAR or limited > 0


def test_films(library: ctypes.CDLL) -> None:
    rng = np.random.default_rng(5)
    for _ in range(2000):
        conductance, exponent = rng.uniform(0.1, 20.0), rng.uniform(-0.3, 0.6)
        difference = float(rng.choice([0.0, 1e-10, rng.uniform(-150.0, 150.0)]))
        ours, _ = laws.film_excess_w(conductance, exponent, difference)
        assert library.film_excess_w(conductance, exponent, difference) == pytest.approx(
            ours, rel=1e-11, abs=1e-12
        )


def test_what_the_compiler_refuses_is_one_line() -> None:
    needed("gcc libc6-dev", "cc")
    with pytest.raises(ValueError, match=r"cc: ended with 1 \(laws.c:1:.*error"):
        compile_library({"laws.c": b"this is no C"})
