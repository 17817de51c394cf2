"""The work of `sitl record` and `sitl compare`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

from ..errors import SitlError
from . import page
from .agreement import compare
from .apart import not_flown, reason
from .cases import CASES
from .manners import MANNERS
from .observer import Timeout
from .recorder import record
from .recording import Recording, load
from .subjects import ArduCopter, Px4, Simulated, StandIn, Subject

RECORDINGS = Path(__file__).resolve().parents[3] / "recordings"
"""The project's own recordings of real autopilots."""
Say = Callable[[str], None]


def subject(
    px4_dir: Path | None = None, ardupilot_dir: Path | None = None, stand_in_like: str | None = None, instance: int = 0
) -> Subject:
    """The autopilot that the options name."""
    if [px4_dir, ardupilot_dir, stand_in_like].count(None) != 2:
        raise SitlError("expected one of --px4-dir FOLDER, --ardupilot-dir FOLDER and --stand-in px4 or ardupilot")
    if not 0 <= instance <= 249:
        raise SitlError(f"--instance {instance}: expected 0 to 249")
    if px4_dir is not None:
        return Px4(px4_dir, instance)
    if ardupilot_dir is not None:
        return ArduCopter(ardupilot_dir, instance)
    if stand_in_like not in MANNERS:
        raise SitlError(f"--stand-in {stand_in_like!r}: expected one of {', '.join(MANNERS)}")
    return StandIn(14_580 + instance, stand_in_like)


def record_into(path: Path, flown: Subject, names: list[str], say: Say) -> None:
    """Fly the named cases, or all that apply, and add each to the file once it is over.

    Raises SitlError before the first flight if a name, or the file, cannot be used.
    """
    like = flown.manners.name
    for name in names:
        if name not in CASES:
            raise SitlError(f"--case {name!r}: expected one of {', '.join(CASES)}")
        if (why := not_flown(like, name)) is not None:
            raise SitlError(f"--case {name!r}: does not apply to {like}: {why}")
        if CASES[name].link not in flown.links:
            raise SitlError(f"--case {name!r}: {flown.described} has no link {CASES[name].link!r}")
    if not os.access(path.parent, os.W_OK):
        raise SitlError(f"{path}: its folder cannot be written to")
    before = load(path) if path.exists() else Recording(flown.described, like=like)
    if before.like != like:
        raise SitlError(f"{path}: a recording like {before.like}, and {flown.described} is like {like}")

    def done(recording: Recording, name: str) -> None:
        together = Recording(before.autopilot, like=before.like)
        together.add(before)
        together.add(recording)
        together.save(path)
        say(f"{name}: done")

    _record(flown, names or CASES, done)


def compare_with(first: Path | None, second: Path | None, write: Path | None, say: Say) -> list[str]:
    """The facts that differ, a line each; with the stand-in as the second, without those listed in `apart`."""
    recording = load(first or RECORDINGS / "px4-main.json")
    other = load(second) if second is not None else stand_in(recording.cases, recording.like)
    if other.like != recording.like:
        raise SitlError(f"{second}: a recording like {other.like}: expected one like {recording.like}")
    facts = compare(recording, other)
    if write is not None:
        page.write(write, recording, other)
    differing = [fact for fact in facts if not fact.agrees]
    say(f"{len(facts) - len(differing)} of {len(facts)} facts agree")
    return [
        str(fact) for fact in differing if second is not None or reason(recording.like, fact.case, fact.name) is None
    ]


def stand_in(names: Iterable[str], like: str = "px4") -> Recording:
    """The stand-in's own recording of cases, each flown by a new one in simulated time."""
    recording = Recording("stand-in", like=like)
    for name in names:
        recording.add(_record(Simulated(like), [name], lambda _, __: None))
    return recording


def _record(flown: Subject, names: Iterable[str], done: Callable[[Recording, str], None]) -> Recording:
    try:
        return record(flown, names, done)
    except Timeout as error:
        raise SitlError(f"{flown.described}: {error}") from error
