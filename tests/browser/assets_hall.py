"""A service with a template, whose assets a test adds and removes."""

from pathlib import Path

from site_files import MACHINE, asset_table, pushed

from tests.browser.plant import Plant

IN_FILE = "axle-0"
CONFIGURATION = f"""
[[templates]]
name = "axle"
bearing = "6311"
group = "Line {{line}}"
values = {{ line = "A" }}
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
limits = {{ t_inner_ring_c = {{ warning = "{{warning}}", alarm = 95 }} }}
[templates.channels]
{pushed()}
[[assets]]
id = "axle-0"
template = "axle"
values = {{ warning = 70 }}
"""
#: An asset without a template, as JSON.
ALONE = {key: value for key, value in asset_table("", MACHINE).items() if key != "id"} | {
    "name": "Spindle"
}


class Hall(Plant):
    """A service with a template, and one asset in its file."""

    rate = 1.0
    in_file = (IN_FILE,)

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, dict.fromkeys(self.in_file, MACHINE))

    def configure(self) -> str:
        return CONFIGURATION

    def ready(self) -> bool:
        listed = self.client.get("/api/v1/assets")
        return listed.is_success and len(listed.json()["items"]) == len(self.in_file)

    def put(self, asset: str, name: str | None = None) -> None:
        table = {"template": "axle", "values": {"warning": 70}} | ({"name": name} if name else {})
        answer = self.client.put(f"/api/v1/assets/{asset}", json=table)
        assert answer.is_success, answer.text

    def provisioned(self) -> dict[str, dict[str, object]]:
        return {one["id"]: one["table"] for one in self.get("/provisioning")["items"]}


class EmptyHall(Hall):
    """A service with a template alone."""

    in_file = ()

    def configure(self) -> str:
        return super().configure().partition("[[assets]]")[0]
