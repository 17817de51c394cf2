"""Rules of a ground station, judged by what the kit received while its script ran."""

from __future__ import annotations

from itertools import pairwise

from mqttxt.core.clock import expiry_s

from . import shapes
from .deaf import SILENT_S
from .gs_kit import EPOCH, LONGEST_LEASE_S, GsKit, Timed
from .registry import NotTested, expect, rule

CONFIRMED_MS = 5000
"""The time within which the kit's beacon confirms a registration."""


def _live(kit: GsKit) -> list[Timed]:
    """The registrations of the first run, without the one that ends the lease."""
    session = kit.enrolments[0].fields["session"]
    return [one for one in kit.enrolments if one.fields["session"] == session and one.fields["lease_s"] > 0]


def _commands(kit: GsKit) -> list[Timed]:
    """The commands of the first run; raises NotTested if the station sent none."""
    session = kit.enrolments[0].fields["session"]
    found = [command for command in kit.commands if command.fields["gs_session"] == session]
    if not found:
        raise NotTested(f"no command came; {'; '.join(kit.malformed[:2]) or 'let the station send some to the drone'}")
    return found


def _first(kit: GsKit) -> list[Timed]:
    """The first copy of each command."""
    found: dict[bytes, Timed] = {}
    for command in _commands(kit):
        found.setdefault(command.heard.payload, command)
    return [*found.values()]


def _is_repeated(kit: GsKit, earlier: Timed, later: Timed) -> bool:
    """Whether `later` repeats `earlier`: the same command, sent before the kit had answered `earlier`."""
    answered_ms = kit.answered.get(earlier.heard.payload, later.heard.at_ms)
    return earlier.fields["command"] == later.fields["command"] and later.heard.at_ms <= answered_ms


@rule("gs", "R6.1", "R3.2", "R3.4")
async def registers_as_specified(kit: GsKit) -> str:
    """A registration has its fields, is not retained, comes at QoS 1, and has a fresh nonce."""
    bad = [text for text in kit.malformed if "init_connect" in text]
    expect(not bad, "; ".join(bad[:2]))
    found = _live(kit)
    for one in found:
        expect(not one.heard.retain, f"{shapes.shown(one.heard.payload)} is retained")
        expect(one.heard.qos == 1, f"{shapes.shown(one.heard.payload)} came at QoS {one.heard.qos}, expected 1")
    nonces = [one.fields["nonce"] for one in found]
    expect(len(set(nonces)) == len(nonces), f"nonces {nonces}: one came twice")
    return f"{len(found)} registrations, the first {shapes.shown(found[0].heard.payload)}"


@rule("gs", "R6.1", "R6.13")
async def marks_what_is_not_confirmed(kit: GsKit) -> str:
    """The first registration has `anew` and names the activator's session; once it is confirmed, renewals have not."""
    found = _live(kit)
    first, later = found[0], found[1:]
    expect(first.fields.get("anew"), "the first registration has no `anew`")
    named = first.fields.get("activator_session")
    expect(named == first.session, f"the first registration names session {named}; expected {first.session}")
    if not later:
        raise NotTested("no second registration came")
    renewed = [
        one for one in later if one.session == first.session and one.heard.at_ms > first.heard.at_ms + CONFIRMED_MS
    ]
    expect(not any(one.fields.get("anew") for one in renewed), "a renewal has `anew`")
    return f"the first of {len(found)} registrations has it, {len(renewed)} renewals have not"


@rule("gs", "R9.1")
async def birth_carries_the_session(kit: GsKit) -> str:
    """The birth on gs/G/reachable is retained, with the registration's name and session."""
    fields = kit.enrolments[0].fields
    topic = f"{kit.prefix}gs/{fields['name']}/reachable"
    births = [(heard, presence) for heard, presence in kit.presences() if heard.topic == topic and presence["up"]]
    expect(births, f"no birth on {topic}")
    heard, presence = births[0]
    expect(heard.retain and heard.qos == 1, f"{topic}: RETAIN {heard.retain}, QoS {heard.qos}; expected True, 1")
    expect(presence["session"] == fields["session"], f"birth {presence}, registered as {fields['session']}")
    return f"{topic} {presence}, retained"


@rule("gs", "R6.1")
async def subscribes_before_it_registers(kit: GsKit) -> str:
    """When its registration comes, it is subscribed to the fog's clock, words and states."""
    if kit.unheard is None:
        raise NotTested("this broker does not say when nobody is subscribed (PUBACK 0x10)")
    expect(not kit.unheard, f"PUBACK 0x10 (nobody subscribed) at the registration for {', '.join(kit.unheard)}")
    return "at the registration the broker had a subscriber for fogX/clock, a result and a state"


@rule("gs", "R6.1")
async def renews_at_a_third(kit: GsKit) -> str:
    """It renews its lease at a third of it."""
    found = _live(kit)
    lease_s = found[0].fields["lease_s"]
    if lease_s > LONGEST_LEASE_S:
        raise NotTested(f"a lease of {lease_s} s: the kit watches one of up to {LONGEST_LEASE_S} s")
    same = [one for one in found if one.session == kit.sessions[0]]
    expect(len(same) > 1, f"a lease of {lease_s} s was not renewed within {lease_s / 3 * 1.25 + 1:.0f} s")
    gap_s = (same[1].heard.at_ms - same[0].heard.at_ms) / 1000
    expect(gap_s <= lease_s / 3 * 1.25, f"a lease of {lease_s} s was renewed after {gap_s:.1f} s")
    return f"a lease of {lease_s} s was renewed after {gap_s:.1f} s"


@rule("gs", "R6.4", "R4.4")
async def bounds_its_lease(kit: GsKit) -> str:
    """Where a registration says until when it is meant, that is made as a command's deadline is."""
    found = [one for one in _live(kit) if "until_ms" in one.fields and one.latest_ms > one.fields["lease_s"] * 1000]
    if not found:
        raise NotTested("no registration with until_ms came after a beacon")
    for one in found:
        until_ms = one.fields["until_ms"]
        expect(until_ms <= one.latest_ms + 1, f"until {until_ms} ms, no later than {one.latest_ms:.0f} is allowed")
    last = found[-1]
    return f"{len(found)} registrations, the last until {last.fields['until_ms']} of at most {last.latest_ms:.0f} ms"


@rule("gs", "R6.1")
async def registers_anew(kit: GsKit) -> str:
    """When the activator is there in a new session, it registers again."""
    anew = [one for one in _live(kit) if one.session == kit.sessions[1]]
    expect(anew, f"session {kit.sessions[0]}, then {kit.sessions[1]}: no registration within 5 s")
    took_ms = anew[0].heard.at_ms - kit.anew_ms
    return f"session {kit.sessions[0]}, then {kit.sessions[1]}: registered {took_ms} ms later"


@rule("gs", "R9.1")
async def watches_its_retained_topic(kit: GsKit) -> str:
    """When its topic shows another session, it publishes its birth again."""
    fields = kit.enrolments[0].fields
    if kit.upset_ms is None:
        raise NotTested("its name is not known")
    again = [
        presence
        for heard, presence in kit.presences()
        if heard.at_ms >= kit.upset_ms and presence["up"] and presence["session"] == fields["session"]
    ]
    expect(again, f"gs/{fields['name']}/reachable went on to show another session's down")
    return "birth again after another session's down"


@rule("gs", "R3.2", "R4.6", "R4.7")
async def addresses_the_activators_session(kit: GsKit) -> str:
    """A command is as specified, has a deadline, and names the session that the beacons name."""
    bad = [text for text in kit.malformed if "commands" in text]
    expect(not bad, "; ".join(bad[:2]))
    for command in _first(kit):
        shown = shapes.shown(command.heard.payload)
        expect("deadline_ms" in command.fields, f"{shown}: no deadline")
        named = command.fields["executor_session"]
        expect(named == command.session, f"{shown}: session {named}, the beacons name {command.session}")
    return f"{len(_first(kit))} commands, the first {shapes.shown(_first(kit)[0].heard.payload)}"


@rule("gs", "R4.4")
async def never_makes_a_deadline_later(kit: GsKit) -> str:
    """A deadline is not after the newest beacon's time, what has passed since, and the ttl; each slowed by 2 rho."""
    said = []
    for command in _first(kit):
        deadline_ms, latest_ms = command.fields.get("deadline_ms", 0), command.latest_ms
        text = f"deadline {deadline_ms}, no later than {latest_ms:.0f} is allowed"
        expect(deadline_ms <= latest_ms + 1, f"ttl {kit.ttl_ms} ms, beacons 400 ms under way: {text}")
        expect(deadline_ms > latest_ms - kit.ttl_ms, f"ttl {kit.ttl_ms} ms: {text}: it is past already")
        said.append(f"{latest_ms - deadline_ms:.0f}")
    return f"ttl {kit.ttl_ms} ms, beacons 400 ms under way: before the latest by {', '.join(said)} ms"


@rule("gs", "R5.2")
async def never_retains_a_command(kit: GsKit) -> str:
    """Commands are published without RETAIN."""
    retained = [command for command in _commands(kit) if command.heard.retain]
    expect(not retained, f"{len(retained)} commands with RETAIN on {retained[0].heard.topic if retained else ''}")
    return f"{len(_commands(kit))} messages, none with RETAIN"


@rule("gs", "R4.9")
async def sets_the_expiry(kit: GsKit) -> str:
    """MQTT's expiry of a command is its ttl in seconds, at least 1."""
    most = expiry_s(kit.ttl_ms)
    found = [command.heard.expiry_s for command in _first(kit)]
    expect(all(one is not None and 1 <= one <= most for one in found), f"ttl {kit.ttl_ms} ms: expiry {found}")
    return f"ttl {kit.ttl_ms} ms: expiry {found}"


@rule("gs", "R5.1")
async def counts_by_one(kit: GsKit) -> str:
    """`seq` rises by one with each command of a session."""
    different: list[Timed] = []
    for command in _first(kit):
        known = [one for one in different if one.fields["seq"] == command.fields["seq"]]
        same = [one for one in known if _is_repeated(kit, one, command)]
        different += [] if same else [command]
    numbers = [command.fields["seq"] for command in different]
    if len(numbers) < 2:
        raise NotTested("only one command came; let the station send at least two")
    steps = [later - earlier for earlier, later in pairwise(numbers)]
    expect(set(steps) == {1}, f"seq {numbers}")
    return f"seq {numbers}"


@rule("gs", "R10.1", "R5.10")
async def sends_the_same_bytes_again(kit: GsKit) -> str:
    """What is not answered is sent again with the same bytes; at QoS 1 not before its deadline."""
    first = _first(kit)[0]
    key = (first.fields["gs_session"], first.fields["seq"])
    until_ms = kit.answered.get(first.heard.payload, kit.clock.now_ms())
    same = [
        command
        for command in _commands(kit)
        if (command.fields["gs_session"], command.fields["seq"]) == key and command.heard.at_ms < until_ms
    ]
    expect(len(same) > 1, f"unanswered for {(until_ms - first.heard.at_ms) / 1000:.1f} s: it was not sent again")
    other = [command for command in same if command.heard.payload != first.heard.payload]
    before, after = shapes.shown(first.heard.payload), shapes.shown(other[0].heard.payload) if other else ""
    expect(not other, f"{before} came again as {after}")
    gap_ms = same[1].heard.at_ms - first.heard.at_ms
    if first.heard.qos == 1:
        expect(gap_ms >= kit.ttl_ms - 700, f"ttl {kit.ttl_ms} ms, QoS 1: sent again after {gap_ms} ms")
    return f"sent {len(same)} times with the same bytes, first again after {gap_ms} ms"


@rule("gs", "R5.9")
async def is_quiet_after_the_last_word(kit: GsKit) -> str:
    """A command that has its last word is not sent again."""
    late = [
        command
        for command in _commands(kit)
        if command.heard.at_ms > kit.answered.get(command.heard.payload, command.heard.at_ms) + 500
    ]
    expect(not late, f"{shapes.shown(late[0].heard.payload) if late else ''}: sent again after its last word")
    return f"{len(kit.answered)} commands were completed, none came again"


@rule("gs", "R10.6")
async def reads_words_together(kit: GsKit) -> str:
    """A broadcast whose words came in one message, with its roster where that is not signed, is not sent again."""
    if not kit.together:
        raise NotTested("no broadcast came of a station that asks for bundles")
    for command in kit.together:
        after = [one for one in kit.commands if one.heard.payload == command.heard.payload]
        late = [one for one in after if one.heard.at_ms > kit.answered[command.heard.payload] + 500]
        expect(not late, f"{shapes.shown(command.heard.payload)}: sent again after its words had come together")
    return f"{len(kit.together)} broadcasts were completed by words together, none came again"


@rule("gs", "R6.8")
async def names_the_newest_epoch(kit: GsKit) -> str:
    """A command carries the newest epoch of control in the drone's record."""
    epochs = [command.fields["epoch"] for command in _first(kit)]
    expect(set(epochs) == {EPOCH}, f"the record says epoch {EPOCH}; commands carry {epochs}")
    return f"the record says epoch {EPOCH}; commands carry {epochs}"


@rule("gs", "R3.3")
async def stands_nonsense(kit: GsKit) -> str:
    """Payloads that are none, on the topics that it hears, do not end it."""
    anew = [one for one in _live(kit) if one.session == kit.sessions[1]]
    expect(anew, "after nonsense on fogX/clock, a result and a state it registered no more")
    return "after nonsense on fogX/clock, a result and a state it went on"


@rule("gs", "R6.2", "R9.3")
async def a_clean_stop_ends_the_lease(kit: GsKit) -> str:
    """At a clean stop it ends its lease and says `down`, with its session."""
    kit.subject.need()
    session = kit.enrolments[0].fields["session"]
    ends = [one for one in kit.enrolments if one.fields["session"] == session and one.fields["lease_s"] == 0]
    said = [presence for _, presence in kit.presences(0, kit.stopped_mark) if presence["session"] == session]
    expect(ends, "no registration with a lease of 0 s at the end")
    expect(said and said[-1]["up"] is False, f"its last presence was {said[-1] if said else 'missing'}")
    expect(kit.exit_code is not None, "it went on 10 s after SIGTERM")
    return f"lease_s 0, then {said[-1]}; exit code {kit.exit_code}"


@rule("gs", "R9.1")
async def will_carries_the_session(kit: GsKit) -> str:
    """Killed, its will says `down` with its session."""
    kit.subject.need()
    if kit.killed_mark is None:
        raise NotTested("started a second time it did not register")
    session = kit.enrolments[-1].fields["session"]
    wills = [presence for _, presence in kit.presences(kit.killed_mark)]
    own = kit.last_words()
    expect(own and not own[0]["up"], f"SIGKILL: came {wills}, expected session {session}, down")
    return f"will {own[0]}"


@rule("gs", "R9.17")
async def asks_whether_it_is_heard(kit: GsKit) -> str:
    """Where it has heard nothing for 12 s it publishes its birth again."""
    kit.subject.need()
    if kit.hushed is None:
        raise NotTested("started a second time it did not register")
    births, (_, hushed_ms) = kit.births_in_silence(), kit.hushed
    expect(births, f"no birth after {SILENT_S:g} s in which it heard nothing")
    return f"its birth came again after {(births[0].at_ms - hushed_ms) / 1000:.1f} s of silence"
