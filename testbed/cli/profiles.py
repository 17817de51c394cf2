"""`testbed profiles` lists the profiles; `testbed profiles show NAME` prints one's links and the kernel's commands."""

from __future__ import annotations

import json
import os
import re
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from net.link_plan import LinkPlan

from ..errors import UserError
from ..plan.experiments import MOST_ATTEMPTS, WITH_SENSORS
from ..plan.fleets import fleet_of
from ..plan.profiles.directed import directed_links
from ..plan.profiles.kernel import Commands, commands_of
from ..plan.profiles.reading import Profile, profile_names, read_profile
from ..plan.profiles.resolve import LinksPlan, resolve
from ..plan.profiles.units import parse_time_us, show_rate, show_share, show_time

COLUMNS = ("link", "rate", "queue", "delay", "jitter", "loss", "duplicate", "corrupt", "reorder")
_LONGEST_S = 3_600


def profiles(context: typer.Context) -> None:
    """List the link profiles; `show` prints one in full."""
    if context.invoked_subcommand is not None:
        return
    table = Table(box=None, show_header=False, pad_edge=False)
    for name in profile_names():
        table.add_row(name, read_profile(name).description)
    Console(highlight=False, width=120).print(table)


def show(
    name: Annotated[str, typer.Argument(help="A profile's name, or the path of a file of your own.")],
    experiment: Annotated[str, typer.Option(help="What is flown; its links and the seed.")] = "scenario-1",
    attempt: Annotated[str, typer.Option(help="Which attempt; the seed depends on it.")] = "1",
    length: Annotated[str, typer.Option(help="How long the links are shaped, as 60s.")] = "60s",
    sources: Annotated[bool, typer.Option("--sources", help="Say where each figure comes from instead.")] = False,
    json_plan: Annotated[bool, typer.Option("--json", help="Only the plan that shapers take, as JSON.")] = False,
) -> None:
    """Show a profile's links in a table, then its events and the commands for a kernel that has netem."""
    if not attempt.isascii() or not attempt.isdecimal() or not 1 <= int(attempt) <= MOST_ATTEMPTS:
        raise UserError(f"--attempt {attempt}: expected a whole number from 1 to {MOST_ATTEMPTS}")
    topology = fleet_of(os.environ).topology(sensors=experiment in WITH_SENSORS)
    profile = read_profile(name)
    plan = resolve(profile, topology, experiment, int(attempt), _seconds(length))
    if json_plan:
        typer.echo(json.dumps(plan.to_data(), indent=1))
        return
    console = Console(highlight=False, width=120)
    console.print(f"{profile.name}: {profile.description}", markup=False, soft_wrap=True)
    console.print(table_of(plan))
    if sources:
        for line in sources_of(profile, plan):
            console.print(line, markup=False, soft_wrap=True)
        return
    console.print(f"\nseed {plan.seed} ({experiment}, attempt {attempt})")
    if plan.events:
        console.print(table_of_events(plan))
    links = directed_links(plan, topology)
    if not links:
        console.print("\nno command: nothing is shaped")
        return
    node = links[0].destination
    typer.echo(f"\n# @{node} is the interface of net towards {node}")
    typer.echo("\n".join(script_of(commands_of(plan, topology))))


def script_of(commands: Commands) -> list[str]:
    """The commands, one per line; those at later times follow a comment with the seconds since the start."""
    if not commands.begin:
        return []
    lines = [" ".join(words) for words in commands.begin]
    last = 0.0
    for at_s, words in commands.timed:
        if at_s != last:
            lines.append(f"# at {at_s:.6f} s")
        last = at_s
        lines.append(" ".join(words))
    return [*lines, "# at the end", *(" ".join(words) for words in commands.end)]


def table_of(plan: LinksPlan) -> Table:
    """Every directed link with its figures; links of a class with the same figures share a row."""
    table = Table(*COLUMNS, box=None, pad_edge=False, header_style="bold")
    rows: dict[tuple[str, ...], list[str]] = {}
    for name, link in plan.links.items():
        direction = name.rpartition(":")[2]
        rows.setdefault((name.partition(":")[0], direction, *_cells(link)), []).append(name)
    for (kind, direction, *cells), names in rows.items():
        nodes = [name.split(":")[1] for name in names]
        table.add_row(f"{kind}:{_run_of(nodes)}:{direction}", *cells)
    return table


def _run_of(nodes: list[str]) -> str:
    """Nodes with consecutive numbers as `uav1-6`, others as a list."""
    numbers = [re.fullmatch(r"([a-z]+)([0-9]+)", node) for node in nodes]
    found = [match for match in numbers if match is not None]
    stems = {match[1] for match in found}
    values = [int(match[2]) for match in found]
    if len(found) < 2 or len(found) != len(nodes) or len(stems) != 1:
        return ",".join(nodes)
    if values == list(range(values[0], values[0] + len(values))):
        return f"{stems.pop()}{values[0]}-{values[-1]}"
    return ",".join(nodes)


def _cells(link: LinkPlan) -> tuple[str, ...]:
    jitter = "-"
    if link.jitter_us:
        order = ", may overtake" if link.reordering else ""
        jitter = f"{show_time(link.jitter_us)} {link.distribution}{order}"
    rate = "-" if link.rate_bps is None else show_rate(link.rate_bps) + (" shared" if link.shared_with else "")
    shares = (link.loss, link.duplicate, link.corrupt, link.reorder)
    return (
        rate,
        "-" if link.queue_packets is None else f"{link.queue_packets} packets",
        show_time(link.delay_us) if link.delay_us else "-",
        jitter,
        *(show_share(share) if share else "-" for share in shares),
    )


def table_of_events(plan: LinksPlan) -> Table:
    """The events of the plan, sorted by time."""
    table = Table("at", "link", "for", "change", box=None, pad_edge=False, header_style="bold")
    for event in plan.events:
        said = ", ".join("closed" if key == "closed" else f"{key} {value}" for key, value in event.change.items())
        table.add_row(f"{event.at_s:.3f} s", event.link, f"{event.for_s:.3f} s", said)
    return table


def sources_of(profile: Profile, plan: LinksPlan) -> list[str]:
    """Every figure in force, once: its file and field, its value, and its source."""
    lines: dict[str, None] = {}
    for figures in plan.figures.values():
        for figure in figures.values():
            lines[f"{figure.where} = {figure.text}: {' '.join(figure.source.split())}"] = None
    for rule in profile.rules:
        lines[f"{rule.where}: {' '.join(rule.source.split())}"] = None
    return list(lines)


def _seconds(text: str) -> float:
    try:
        seconds = parse_time_us(text) / 1_000_000
    except ValueError as error:
        raise UserError(f"--length {text}: expected {error}") from error
    if not 0 < seconds <= _LONGEST_S:
        raise UserError(f"--length {text}: expected more than 0s, at most {_LONGEST_S}s")
    return seconds
