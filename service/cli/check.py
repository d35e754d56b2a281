"""``bearing-twin check``: what is wrong with a configuration, and what its sources say now."""

import asyncio
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.known_assets import store_problems
from service.cli.serve import ConfigFile
from service.domain.channels import unit_of
from service.feature_folders import modules
from service.site.configuration import readable_secrets

if TYPE_CHECKING:
    from service.ingest.probing import Probe
    from service.site.examination import Examination


def check(
    config: ConfigFile = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON document on standard output.")
    ] = False,
) -> None:
    """Check a configuration and read each of its sources once; nothing is stored.

    Lists everything that is wrong, one line each, and the present value of every channel. Exit
    status 0: all sections are right, the assets in the store fit them, every source answers and
    every channel that is read has a good value; else 2. A warning names each alarm setting that
    was changed in the store. A serial port can be read only while the service does not run.
    """
    # Imported here: the field libraries take a second to load, which --help should not pay.
    from service.app.checking import environment_errors, machine_warnings, place_problems
    from service.ingest.probing import probe, unit_doubts
    from service.logs import configure_logging
    from service.plant.publishers import warnings as publisher_warnings
    from service.site.examination import examine

    configure_logging("critical")
    found = examine(config)
    errors, warnings = list(found.errors), list(found.warnings)
    where = "" if config is None else f"{config}: "
    if found.settings is not None:
        errors += [where + line for line in environment_errors(found.settings)]
        warnings += [where + line for line in publisher_warnings(found.settings)]
        warnings += [where + line for line in readable_secrets(config)]
        for _, feature in modules("health"):
            warnings += feature.warnings(found.settings)
        for problems in (store_problems, place_problems):
            wrong, doubtful = problems(found.settings)
            errors += [where + line for line in wrong]
            warnings += [where + line for line in doubtful]
    else:
        warnings.append(f"{where}the assets in the store were not checked: see the errors")
    warnings += machine_warnings()
    probed = asyncio.run(probe(found.wiring))
    errors += [where + line for line in probed.problems]
    warnings += [where + line for line in probed.warnings]
    warnings += [where + line for line in unit_doubts(found.settings, probed)]
    if as_json:
        from service.documents.checks import CheckDocument

        file = None if config is None else str(config)
        typer.echo(CheckDocument.of(file, errors, warnings, probed).to_bytes().decode())
    else:
        _print(found, probed)
    for line in errors:
        sys.stderr.write(f"bearing-twin: {line}\n")
    for line in warnings:
        sys.stderr.write(f"bearing-twin: warning: {line}\n")
    if errors:
        raise typer.Exit(2)


def _print(found: "Examination", probed: "Probe") -> None:
    from rich.table import Table

    from adapters.samples import meaning
    from service.cli.consoles import make_console

    console = make_console()
    if probed.sources:
        sources = Table("source", "driver", "answers", "detail")
        for one in probed.sources:
            sources.add_row(one.name, one.driver, "yes" if one.up else "no", one.detail)
        console.print(sources)
    if probed.channels:
        values = Table("asset", "channel", "value", "unit", "quality", "age", "source")
        for channel in probed.channels:
            quality = channel.quality
            word = channel.detail if quality is None else meaning(quality) or "good"
            values.add_row(
                channel.asset,
                channel.channel,
                "-" if channel.value is None else f"{channel.value:.6g}",
                unit_of(channel.channel),
                word,
                "-" if channel.age_s is None else f"{channel.age_s:.1f} s",
                channel.source,
            )
        console.print(values)
    for plan in probed.plans:
        steps = "not read" if plan.steps is None else f"{plan.steps} steps ahead"
        console.print(f"plan of {plan.asset} (source {plan.source}): {steps}")
    if found.settings is not None and not found.settings.assets:
        console.print("The configuration has no assets.")
