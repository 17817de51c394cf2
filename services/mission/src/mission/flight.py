"""A mission from its fleet's connection to its end, with its records."""

from __future__ import annotations

from collections.abc import Callable

from .events import EventLog
from .fleet import Fleet, MissionError
from .options import Options
from .own import Mission
from .series import compare, has_measured, read_measured, write
from .steps import Steps

CONNECT_LIMIT_S = 30.0


async def fly(options: Options, mission: Mission, fleet: Fleet, log: EventLog) -> str | None:
    """Fly a mission; returns the reason of a failure, None without one. The links' clock starts with the mission."""
    reason = None
    try:
        await fleet.connect(CONNECT_LIMIT_S)
        log.write("mission_start", scenario=options.scenario, drones=list(fleet.drones))
        if options.links_start is not None:
            options.links_start.touch()
        await mission(fleet, Steps(fleet, log, options.samples, _reached(options)))
    except MissionError as error:
        reason = str(error)
    finally:
        await fleet.close()
    broken = _check_series(options, fleet, log)
    reason = reason or broken
    log.write("mission_end", status="failed" if reason else "completed", reason=reason)
    return reason


def _reached(options: Options) -> Callable[[int], bool]:
    """A function that returns whether a drone's sensor has measured anything; True if sensors keep no record."""
    folder = options.sensors
    return lambda drone: folder is None or has_measured(folder, drone)


def _check_series(options: Options, fleet: Fleet, log: EventLog) -> str | None:
    """Compare the arrived readings with the sensors' records, for missions that collect; returns the differences."""
    if options.sensors is None or options.series is None:
        return None
    measured = read_measured(options.sensors, fleet.drones)
    found = compare(fleet.drones, measured, fleet.readings, options.samples)
    write(found, options.series)
    for one in found:
        log.write("series", **one.to_data())
    broken = [str(one) for one in found if not one.is_whole]
    return f"series: {'; '.join(broken)}" if broken else None
