"""The model of the bearing that most tests are about."""

import pytest

from twin_core.bearings import bearing
from twin_core.models import ThermalModel, build_model


@pytest.fixture(scope="session")
def model() -> ThermalModel:
    return build_model(bearing=bearing("6311"))
