"""Flies cases on an autopilot and collects their recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from .apart import not_flown
from .cases import CASES
from .observer import Timeout
from .pilot import Pilot
from .recording import Recording
from .subjects import Subject, wait_ready

SETTLED_S = 3.0
"""The pause between two cases, in which the effects of the first end."""


def record(
    subject: Subject, names: Iterable[str], done: Callable[[Recording, str], None] = lambda _, __: None
) -> Recording:
    """Fly the cases one after the other on one autopilot, each in the state left by the one before, but at rest.

    `done` is called after each case. Raises Timeout if a case does not finish, SitlError if the autopilot does not
    run.
    """
    recording = Recording(subject.described, like=subject.manners.name)
    with subject:
        pilots: dict[str, Pilot] = {"onboard": subject.pilot("onboard")}
        wait_ready(subject, pilots["onboard"])
        for name in names:
            procedure = CASES[name]
            if procedure.link not in subject.links or not_flown(recording.like, name) is not None:
                continue
            if procedure.link not in pilots:
                pilots[procedure.link] = subject.pilot(procedure.link)
            _settle(pilots["onboard"])
            pilot = pilots[procedure.link]
            pilot.begin(everything=procedure.counts)
            try:
                procedure.fly(pilot)
            except Timeout:
                subject.check()
                raise
            recording.add(Recording(subject.described, {name: [pilot.case]}))
            done(recording, name)
    return recording


def _settle(pilot: Pilot) -> None:
    """Bring the autopilot to the ground, disarmed and at rest."""
    pilot.begin(everything=False)
    if pilot.armed:
        pilot.land()
        pilot.until("disarmed", lambda: not pilot.armed, 120)
    if not pilot.rests:
        pilot.rest()
        pilot.until("at rest", lambda: pilot.rests, 10)
    pilot.wait(SETTLED_S)
