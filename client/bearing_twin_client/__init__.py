"""Python client of Bearing Twin: measurements, identification, forecasts."""

from bearing_twin_client.client import Client
from bearing_twin_client.documents import ProfileStep, TimeWindow
from bearing_twin_client.problem import ProblemError
from bearing_twin_client.rows import Columns, columns

__all__ = ["Client", "Columns", "ProblemError", "ProfileStep", "TimeWindow", "columns"]
