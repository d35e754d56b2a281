"""What a newcomer writes: a driver and a feature, file by file."""

DRIVER = {
    "__init__.py": '''
"""Fixed values, sent again and again."""

from adapters.drivers.steady.config import SteadyChannel, SteadySource
from adapters.protocol import DriverSpec

STEADY = DriverSpec(
    SteadySource,
    SteadyChannel,
    plan_model=None,
    check_function="adapters.drivers.steady.driver:check",
    driver_class="adapters.drivers.steady.driver:SteadyDriver",
)
''',
    "config.py": '''
"""Configuration models."""

from typing import Literal

from adapters.configuration import MeasuredChannel, SourceConfig


class SteadySource(SourceConfig):
    """Sends every `period_s`."""

    driver: Literal["steady"] = "steady"
    period_s: float = 0.2

    @property
    def expected_period_s(self) -> float:
        """As configured."""
        return self.period_s


class SteadyChannel(MeasuredChannel):
    """A channel of one value."""

    value: float
''',
    "driver.py": '''
"""The driver."""

from adapters.protocol import SourceHealth
from adapters.samples import Batch, Quality, Sample


class SteadyDriver:
    """Sends the configured values."""

    def __init__(self, source, channels, plans, clock):
        self._source, self._channels, self._clock = source, channels, clock
        self._health = SourceHealth(source.name, "steady", up=True, detail="ok")

    @property
    def name(self):
        return self._source.name

    async def __aenter__(self):
        return self

    async def __aexit__(self, *_):
        self._health.up = False

    def health(self):
        return self._health

    async def batches(self):
        while True:
            now_us = self._clock.now_us()
            yield Batch(
                [
                    Sample(one.asset, one.channel, now_us, one.config.value, Quality.GOOD, now_us)
                    for one in self._channels
                ]
            )
            self._health.last_good_us = now_us
            await self._clock.sleep(self._source.period_s)


def check(source, channels, plans):
    """Nothing can be wrong."""
''',
}

#: A feature: its table, its answers, its part of the cell and its command.
FEATURE = {
    "__init__.py": '"""Notes of a shift."""\n',
    "tables.py": '''
"""What it keeps."""

from sqlalchemy import insert, select
from sqlalchemy.orm import Mapped, mapped_column

from service.store.audit import add_line
from service.store.part import StorePart
from service.store.records import AuditEntry
from service.store.tables import Base


class ShiftNoteRow(Base):
    """A note."""

    __tablename__ = "shift_notes"

    number: Mapped[int] = mapped_column(primary_key=True)
    text: Mapped[str]


class ShiftNotes(StorePart):
    """Notes by number."""

    def add(self, text: str, line: AuditEntry) -> None:
        """Keep a note, and who made it."""
        with self._database.writing() as connection:
            connection.execute(insert(ShiftNoteRow).values(text=text))
            add_line(connection, line)

    def texts(self) -> list[str]:
        """Give all notes, the first one first."""
        query = select(ShiftNoteRow.text).order_by(ShiftNoteRow.number)
        with self._database.reading() as connection:
            return list(connection.scalars(query))
''',
    "interface.py": '''
"""What is asked of the cell."""

from typing import Protocol

from service.bus.messages import Call


class ShiftBook(Protocol):
    """The book of the shift."""

    @Call(of_any=True)
    async def heading(self, name: str) -> str:
        """Give the heading of a page."""
''',
    "part.py": '''
"""Its part of the cell."""

import asyncio

from service.bus.calls import answering
from service.bus.interface import Handlers
from service.cell.core import Core
from service.features.shift_notes.interface import ShiftBook
from service.tasks import Part


def part(core: Core) -> Part:
    """Make the part."""
    return Book(core)


class Book(Part):
    """Knows the assets of the cell once it works."""

    name = "shift notes"

    def __init__(self, core: Core) -> None:
        self._core = core
        self._assets: list[str] = []

    async def run(self) -> None:
        """Look once a second which assets there are."""
        while True:
            self._assets = sorted(self._core.assets)
            await asyncio.sleep(1.0)

    def handlers(self) -> Handlers:
        """Answer what the interface asks."""
        return answering(ShiftBook)(self)

    def problems(self) -> dict[str, str | None]:
        """Show that the health of the service asks it."""
        return {self.name: "the book is not signed"}

    async def heading(self, name: str) -> str:
        """Give the heading of a page."""
        return f"{name}: {', '.join(self._assets)}"
''',
    "routes.py": '''
"""Its answers."""

from fastapi import APIRouter

from service.domain.requests import RequestBody
from service.domain.roles import OPERATOR, VIEWER
from service.features.shift_notes.interface import ShiftBook
from service.features.shift_notes.tables import ShiftNotes
from service.web.api.access import secured
from service.web.api.deps import Context
from service.web.api.trail import ChangeLine

router = APIRouter(prefix="/shift-notes", tags=["runs"])


class ShiftNote(RequestBody):
    """What is noted."""

    text: str


@router.get("", summary="Notes", **secured(VIEWER))
def list_notes(context: Context) -> list[str]:
    """All of them."""
    return context.store.part(ShiftNotes).texts()


@router.get("/heading", summary="Heading", **secured(VIEWER))
async def get_heading(context: Context, name: str) -> str:
    """As the cell writes it."""
    return await context.cell(ShiftBook).heading(name)


@router.post("", summary="Make a note", status_code=204, **secured(OPERATOR, audit="note.make"))
def add_note(context: Context, note: ShiftNote, line: ChangeLine) -> None:
    """Keep it."""
    context.store.part(ShiftNotes).add(note.text, line)
''',
    "commands.py": '''
"""Its command."""

import typer


def register(app: typer.Typer) -> None:
    """Add ``shift``."""

    @app.command()
    def shift() -> None:
        """Say that the feature is there."""
        typer.echo("notes of a shift")
''',
    "health.py": '''
"""What `check` warns of."""


def warnings(settings):
    """Warn always."""
    return ["nobody is on shift"]
''',
}
MIGRATION = '''
"""Notes of a shift."""

import sqlalchemy as sa
from alembic import op

revision = "{revision}"
down_revision = "{before}"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "shift_notes",
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("text", sa.String(), nullable=False),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_shift_notes")),
    )
'''
