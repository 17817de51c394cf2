"""What counts: the one place where an attempt is judged completed, failed or void.

`observations` examines a flight's folder once, after its containers have ended. `judge` derives a verdict from these
observations, and `paired` combines the attempts of a number. The run writes both into the attempt's manifest, from
which repeats, metrics and reports read the verdict.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .results import Attempt

COMPLETED, FAILED, VOID = "completed", "failed", "void"
RUNNING = "running"
"""A manifest's status until its attempt is judged."""
WATCHED = "the live page showed it (PAGE=1): a station that watches opens the gates of its fogs"
CUT_OFF, INTERRUPTED = "the run was cut off", "interrupted"
"""Failures of the run, not of its fleet; behind CUT_OFF and a colon may be what cut it off."""
_PAIRED = "was void in the same attempt"


@dataclass(frozen=True)
class Observed:
    """The observations of a flight that bear on the verdict. The defaults are those of a flawless flight.

    failure: why the mission was not completed, in its own words; None if it was.
    off_before: why nothing was flown: how the probed links differ from the profile, or why they could not be probed.
    off_links: how the links of the flight differ from the plan, a line each: the shaper's lateness, random losses.
    flights: what the autopilots' logs have against the flight: a slow clock, sensors that stood still, a flight log
        with other events.
    uncaptured: the nodes without a capture.
    dropped: packets that captures dropped, by node, without those that dropped none; None where the count is unknown.
    has_end: whether the mission's events include its end.
    silent: the drones without an event of disarming.
    set_back: the file in which the clock was set back the furthest, and by how many seconds.
    clock_set: by how many seconds this machine's clock was set forward, or (negative) back; None if it was not. A
        machine that is suspended sets its clock forward when it goes on.
    unreadable: unreadable files on which one of these depends, with the reason.
    watched: whether the live page showed the flight.
    """

    failure: str | None = None
    off_before: str | None = None
    off_links: tuple[str, ...] = ()
    flights: tuple[str, ...] = ()
    uncaptured: tuple[str, ...] = ()
    dropped: Mapping[str, int | None] = field(default_factory=dict)
    has_end: bool = True
    silent: tuple[str, ...] = ()
    set_back: tuple[str, float] | None = None
    unreadable: tuple[str, ...] = ()
    watched: bool = False
    clock_set: float | None = None


@dataclass(frozen=True)
class Verdict:
    """`status` is completed, failed or void; `failure` is why the mission of a void attempt failed, if it did."""

    status: str
    reasons: tuple[str, ...] = ()
    failure: str | None = None

    @property
    def reason(self) -> str | None:
        """The reasons in one line; None for a completed attempt."""
        failure = () if self.failure is None else (f"this one had failed: {self.failure}",)
        return "; ".join((*self.reasons, *failure)) or None

    @property
    def is_void(self) -> bool:
        return self.status == VOID

    @property
    def was_only_watched(self) -> bool:
        """Whether the live page is the only reason why the attempt is not completed."""
        return self.reasons == (WATCHED,) and self.failure is None

    @property
    def was_cut(self) -> bool:
        """Whether the run ended before the attempt did: it is flown again, without counting as a repeat."""
        return self.status != COMPLETED and len(self.reasons) == 1 and _is_cut(self.reasons[0])

    @property
    def is_of_its_pair(self) -> bool:
        """Whether the attempt over the other protocol is why it is void (`paired`)."""
        return any(_PAIRED in reason for reason in self.reasons)

    def to_data(self) -> dict[str, Any]:
        """The entries in a manifest."""
        return {"status": self.status, "reason": self.reason}


NOT_ENDED = Verdict(VOID, (CUT_OFF,))
"""The verdict of an attempt that was cut off, once its series goes on without it."""


def cut_off(by: Exception) -> str:
    """The failure of an attempt that something else than its fleet cut off: Docker, a full disk, a wrong option."""
    return f"{CUT_OFF}: {by}"


def written(manifest: Mapping[str, Any]) -> Verdict:
    """The verdict in a manifest; void for one that its run did not complete, or says that it was cut off."""
    if manifest["status"] == RUNNING:
        return NOT_ENDED
    found = Verdict(manifest["status"], () if manifest["reason"] is None else (manifest["reason"],))
    return Verdict(VOID, found.reasons) if found.was_cut else found


def as_measured(void: Mapping[str, Any]) -> Verdict:
    """The verdict of a void attempt in metrics.json."""
    return Verdict(VOID, (void["reason"],))


def unread(reason: str) -> Verdict:
    """The verdict of an attempt whose manifest cannot be read."""
    return Verdict(VOID, (reason,))


def judge(seen: Observed) -> Verdict:
    """The verdict of a flight.

    Links that are not as planned, autopilots that were slowed down, captures that dropped packets, a clock that was
    set, and a live page, which adds traffic, make any attempt void: if its mission failed, they or the busy machine may
    be the cause. Were dropped packets to void only completed attempts, whichever side has more packets would seem to
    fail more often. All else that its numbers lack makes only a completed attempt void: a failed one stays in the
    tables with the numbers that it has. An attempt that was cut off speaks for or against nobody.
    """
    if seen.off_before is not None:
        return Verdict(VOID, (seen.off_before,))
    if seen.watched:
        return Verdict(VOID, (WATCHED,), seen.failure)
    conditions = (*_of_dropped(seen), *seen.off_links, *seen.flights, *_of_clock(seen))
    if seen.failure is not None:
        if _is_cut(seen.failure):
            return Verdict(VOID, (seen.failure,))
        return Verdict(VOID, conditions, seen.failure) if conditions else Verdict(FAILED, (seen.failure,))
    reasons = (*_of_uncaptured(seen), *conditions, *_of_events(seen), *seen.unreadable)
    return Verdict(VOID, reasons) if reasons else Verdict(COMPLETED)


def paired(verdicts: Mapping[Attempt, Verdict]) -> dict[Attempt, Verdict]:
    """Make void every attempt whose counterpart, of the same number and repeat over another protocol, is void."""
    found = {}
    for attempt, verdict in verdicts.items():
        void = next((other for other in verdicts if _are_paired(attempt, other) and verdicts[other].is_void), None)
        if void is not None and not verdict.is_void:
            failure = verdict.reason if verdict.status == FAILED else None
            verdict = Verdict(VOID, (f"{void.protocol} {_PAIRED}",), failure)
        found[attempt] = verdict
    return found


def unmeasured(verdict: Verdict, reason: str) -> Verdict:
    """The verdict of an attempt whose files cannot be measured: void if it was completed, since it has no numbers."""
    return Verdict(VOID, (reason,)) if verdict.status == COMPLETED else verdict


def _are_paired(one: Attempt, other: Attempt) -> bool:
    return (one.number, one.repeat) == (other.number, other.repeat) and one.protocol != other.protocol


def _is_cut(failure: str) -> bool:
    return failure in (CUT_OFF, INTERRUPTED) or failure.startswith(f"{CUT_OFF}: ")


def _of_uncaptured(seen: Observed) -> list[str]:
    return [f"no capture at {', '.join(seen.uncaptured)}"] if seen.uncaptured else []


def _of_dropped(seen: Observed) -> list[str]:
    dropped = [f"{node} {'?' if count is None else count}" for node, count in seen.dropped.items()]
    return [f"captures dropped packets: {', '.join(dropped)}"] if dropped else []


def _of_clock(seen: Observed) -> list[str]:
    if seen.clock_set is None:
        return []
    way = "back" if seen.clock_set < 0 else "forward, or the machine was suspended,"
    return [f"the machine's clock was set {way} by {abs(seen.clock_set):.3f} s during the attempt"]


def _of_events(seen: Observed) -> list[str]:
    reasons = [] if seen.has_end else ["events.jsonl does not have the mission's end"]
    if seen.silent:
        reasons.append(f"no autopilot's own word of disarming: {', '.join(seen.silent)}")
    if seen.set_back is not None:
        file, seconds = seen.set_back
        reasons.append(f"the clock was set back by {seconds:.3f} s during the attempt ({file})")
    return reasons
