"""Rules of an activator about commands: which it forwards, with which deadline, and which words it publishes."""

from __future__ import annotations

import asyncio
import secrets

import cbor2

from mqttxt.protocol.codec import encode, encoding_of
from mqttxt.protocol.commands import Arm, Disarm, Goto, Hold
from mqttxt.protocol.messages import Word

from . import shapes
from .activator_kit import PATIENCE_S, QUIET_S, ActivatorKit
from .fields import FIRST_WORDS
from .registry import expect, rule

_GRACE_MS = 5000
_RATE = 0.002


@rule("activator", "R4.5", "R4.6", "R5.2")
async def passes_a_command_down(kit: ActivatorKit) -> str:
    """A command goes down as it is, but for the drone's session and deadline; its words come up in their order."""
    message = kit.send(Arm())
    came = await kit.comes_down(message)
    words = await kit.outcome(message)
    expect(not came.heard.retain, f"{came.heard.topic}: published with RETAIN")
    expect(came.fields["executor_session"] == kit.one.session, f"drone session {kit.one.session}: {came.fields}")
    sent = shapes.read("command", encode(message, encoding_of(came.heard.payload)))
    for name in ("gs_session", "seq", "limit_s", "epoch", "command"):
        expect(came.fields.get(name) == sent.get(name), f"{name}: {sent.get(name)} became {came.fields.get(name)}")
    expect(words.names == ["accepted", "completed"], f"the drone said accepted, completed; came {words}")
    missing = [word for word in words.words if "relay_stamp" not in word or word["session"] != kit.one.session]
    expect(not missing, f"words without the activator's stamp or of another session: {missing}")
    await asyncio.sleep(QUIET_S)
    copies = len(kit.forwarded(message))
    expect(copies == 1, f"it went down {copies} times")
    return f"{shapes.shown(came.heard.payload)} on {came.heard.topic}; came {words}"


@rule("activator", "R4.4", "R4.5")
async def never_makes_a_deadline_later(kit: ActivatorKit) -> str:
    """The deadline that goes down is not after the one that came, in either clock, and leaves time to start."""
    said = []
    for number, drone in kit.drones.items():
        message = kit.command(Arm(), ttl_ms=4000)
        assert message.deadline_ms is not None
        kit.publish(message, number)
        came = await kit.comes_down(message, number)
        earliest_ms = kit.remote.deadline_ms(kit.clock.now_ms(), 0)
        assert earliest_ms is not None
        left_ms = (message.deadline_ms - earliest_ms) * (1 + 2 * _RATE) + 2
        latest_ms = round(drone.now_ms() + left_ms)
        down_ms = came.fields.get("deadline_ms", 0)
        text = f"drone {number}: deadline {down_ms}, no later than {latest_ms} is allowed"
        expect(down_ms <= latest_ms, f"{text}: {down_ms - latest_ms} ms too late")
        expect(down_ms > came.now_ms, f"{text}; came at {came.now_ms}, with 4 s to go: too early to start")
        said.append(f"{text}; {latest_ms - down_ms} ms before it")
        await kit.outcome(message, number)
    return "; ".join(said)


@rule("activator", "R4.9")
async def sets_the_expiry_anew(kit: ActivatorKit) -> str:
    """MQTT's expiry of what goes down is the remaining time in seconds, at least 1, and not copied."""
    message = kit.command(Arm(), ttl_ms=3000)
    kit.publish(message, expiry_s=3600)
    came = await kit.comes_down(message)
    await kit.outcome(message)
    expiry_s = came.heard.expiry_s
    expect(expiry_s is not None and 1 <= expiry_s <= 3, f"ttl 3 s, came with expiry 3600: went down with {expiry_s}")
    return f"ttl 3 s, came with expiry 3600: went down with {expiry_s}"


@rule("activator", "R4.5", "R5.9")
async def closes_what_is_late(kit: ActivatorKit) -> str:
    """What comes past its deadline is `expired`, in the activator's session, and does not go down."""
    message = kit.command(Arm(), deadline_ms=max(1, kit.deadline(0) - 300))
    return f"0.3 s past its deadline: {(await kit.refused(message, 'expired'))[1]}"


@rule("activator", "R5.9")
async def closes_what_is_unreachable(kit: ActivatorKit) -> str:
    """A command for a drone that is not there is `unreachable`, in the activator's session."""
    words = await kit.outcome(kit.send(Arm(), to=250), 250)
    is_own = (words.last or {}).get("session") == kit.session
    expect(words.names == ["unreachable"] and is_own, f"drone 250 was never there: came {words}")
    return f"drone 250 was never there: came {words}"


@rule("activator", "R4.7")
async def denies_without_a_deadline(kit: ActivatorKit) -> str:
    """Without a deadline, or addressed to no session, it is `denied(no_deadline)`, with a beacon in the answer."""
    said = []
    for message in (kit.command(Arm(), deadline_ms=None), kit.command(Arm(), executor_session=0)):
        words, evidence = await kit.refused(message, "denied", "no_deadline")
        beacon = shapes.nested("beacon", (words.last or {}).get("beacon", []))
        expect(beacon.get("session") == kit.session, f"came {words} with the beacon {beacon or 'missing'}")
        said.append(evidence)
    return f"deadline null: {said[0]}; session 0: {said[1]}"


@rule("activator", "R4.7")
async def denies_a_deadline_too_far(kit: ActivatorKit) -> str:
    """A deadline more than 60 s ahead is `denied(deadline_too_far)`."""
    return (await kit.refused(kit.command(Arm(), ttl_ms=62_000), "denied", "deadline_too_far"))[1]


@rule("activator", "R5.2")
async def refuses_what_is_retained(kit: ActivatorKit) -> str:
    """A command with RETAIN is `denied(retained)`."""
    try:
        return (await kit.refused(kit.command(Arm()), "denied", "retained", retain=True))[1]
    finally:
        kit.cloud.publish(kit.topics.drone_commands(1), b"", retain=True)


@rule("activator", "R5.3")
async def answers_a_duplicate(kit: ActivatorKit) -> str:
    """The same bytes again are answered with the newest word, and do not go down again."""
    message = kit.send(Arm())
    await kit.outcome(message)
    mark = len(kit.cloud.heard)
    kit.publish(message)
    words = await kit.outcome(message, mark=mark)
    await asyncio.sleep(QUIET_S)
    copies = len(kit.forwarded(message))
    expect(copies == 1, f"the same bytes again went down, {copies} times in all")
    expect(words.names == ["completed"], f"to the same bytes again came {words}")
    return f"to the same bytes again came {words}; nothing went down"


@rule("activator", "R5.3")
async def denies_an_id_conflict(kit: ActivatorKit) -> str:
    """The same id with other contents is `denied(id_conflict)`."""
    message = kit.send(Arm())
    await kit.outcome(message)
    mark = len(kit.cloud.heard)
    kit.publish(kit.command(Disarm(), seq=message.seq))
    words = await kit.outcome(message, mark=mark)
    await asyncio.sleep(QUIET_S)
    copies = len(kit.forwarded(message))
    expect(copies == 1, "disarm went down under arm's id")
    reason = str(words.reason)
    expect(words.names == ["denied"] and reason.startswith("id_conflict"), f"arm, then disarm: came {words}")
    return f"arm, then disarm under the same id: came {words}"


@rule("activator", "R3.3")
async def refuses_what_is_malformed(kit: ActivatorKit) -> str:
    """Unknown version, command or type, a missing field, a number out of range: denied, with a reason."""
    said = []
    for name, index, value in (
        ("version 2", 0, 2),
        ("an unknown command", 7, 99),
        ("a text for the limit", 5, "soon"),
        ("a limit of 0", 5, 0),
        ("a float for the deadline", 4, 1.5),
    ):
        message = kit.command(Arm())
        row = cbor2.loads(encode(message))
        row[index] = value
        kit.cloud.publish(kit.topics.drone_commands(1), cbor2.dumps(row))
        words = await kit.outcome(message, limit_s=2)
        kit.expect_kept(message, name)
        is_denied = words.names == ["denied"] and words.reason
        expect(is_denied, f"{name}: {row}: came {words}, expected denied with a reason")
        said.append(name)
    return f"denied with reasons: {', '.join(said)}"


@rule("activator", "R5.11")
async def asks_about_an_earlier_session(kit: ActivatorKit) -> str:
    """A command for another session of the activator goes down as a query only, and its answer has a beacon."""
    message = kit.command(Arm(), executor_session=kit.session % (2**32 - 1) + 1)
    kit.one.words = (Word.EXPIRED,)
    kit.publish(message)
    came = await kit.comes_down(message)
    words = await kit.outcome(message)
    kit.one.words = (Word.ACCEPTED, Word.COMPLETED)
    deadline_ms = came.fields.get("deadline_ms")
    expect(deadline_ms == 0, f"it went down with the deadline {deadline_ms}, expected 0")
    beacon = shapes.nested("beacon", (words.last or {}).get("beacon", []))
    expect(words.names == ["expired"], f"the drone said expired; came {words}")
    expect(beacon.get("session") == kit.session, f"came {words} with the beacon {beacon or 'missing'}")
    return f"went down with deadline 0; came {words} with beacon {beacon}"


@rule("activator", "R5.9")
async def says_one_last_word(kit: ActivatorKit) -> str:
    """Of two last words of a drone only the first is passed on."""
    kit.one.words = (Word.COMPLETED, Word.FAILED, Word.COMPLETED)
    message = kit.send(Arm())
    await kit.outcome(message)
    await asyncio.sleep(QUIET_S)
    kit.one.words = (Word.ACCEPTED, Word.COMPLETED)
    words = kit.words(message)
    expect(words.names == ["completed"], f"the drone said completed, failed, completed: came {words}")
    return f"the drone said completed, failed, completed: came {words}"


@rule("activator", "R5.9")
async def gives_up_and_tells_the_truth(kit: ActivatorKit) -> str:
    """Past deadline, limit and 5 s it says `unconfirmed`; the truth follows once, marked settled."""
    kit.one.words = ()
    message = kit.command(Arm(), ttl_ms=600, limit_s=0.1)
    sent_ms = kit.clock.now_ms()
    kit.publish(message)
    words = await kit.outcome(message, limit_s=10)
    took_ms = (words.at_ms[-1] if words.at_ms else kit.clock.now_ms()) - sent_ms
    kit.one.words = (Word.ACCEPTED, Word.COMPLETED)
    is_own = (words.last or {}).get("session") == kit.session
    expect(words.names == ["unconfirmed"] and is_own, f"the drone kept silent: came {words}")
    expect(took_ms > 600 + _GRACE_MS - 200, f"unconfirmed after {took_ms} ms, before deadline, limit and grace")
    for _ in range(2):
        kit.one.say(message.gs_session, message.seq, "arm", Word.COMPLETED)
    await asyncio.sleep(QUIET_S)
    later = kit.words(message).words[1:]
    settled = [(word["word"], word.get("settled")) for word in later]
    expect(settled == [("completed", True)], f"then the drone said completed, twice: came {settled}")
    return f"silence: unconfirmed after {took_ms} ms; then completed, twice: came {settled}"


@rule("activator", "R5.12")
async def broadcasts_to_its_roster(kit: ActivatorKit) -> str:
    """A broadcast's roster comes before any word, and each of its entries gets one last word."""
    mark = len(kit.cloud.heard)
    message = kit.send(Arm(), to=None)
    await kit.cloud.until(lambda: kit.fog_results(message, mark), PATIENCE_S)
    results = kit.fog_results(message, mark)
    expect(results and "roster" in results[0][1], f"no roster on fogX/commands_result/arm: {results}")
    place, roster = results[0]
    entries = [shapes.roster_entry(entry) for entry in roster["roster"]]
    numbers = [entry[0] for entry in entries]
    known = {number: drone.session for number, drone in kit.drones.items()}
    expect(known.items() <= dict(entries).items(), f"drones {known}: roster {entries}")
    for number in numbers:
        await kit.outcome(message, number)
        words = kit.words(message, number, mark)
        last = [name for name in words.names if name not in FIRST_WORDS]
        expect(len(last) == 1, f"drone {number}: came {words}")
        first = kit.words(message, number, place + 1)
        expect(len(first.words) == len(words.words), f"drone {number}: a word came before the roster")
        if number not in known:
            expect(last == ["unreachable"], f"drone {number} is not there: came {words}")
    return f"roster {entries}, then one last word for each of {numbers}"


@rule("activator", "R10.6")
async def loses_no_word_that_waits(kit: ActivatorKit) -> str:
    """To a station that asks for bundles the roster of a broadcast, and each drone's last word, come once.

    A first word comes once in front of it, or not at all.
    """
    await kit.echoed(kit.station.register(bundles=True))
    message = kit.command(Arm())
    kit.one.words, kit.two.words = (Word.ACCEPTED, Word.COMPLETED), (Word.ACCEPTED, Word.FAILED)
    mark = len(kit.cloud.heard)
    kit.publish(message, None)
    said = {number: await kit.outcome(message, number, mark=mark) for number in kit.drones}
    await asyncio.sleep(QUIET_S)
    kit.two.words = (Word.ACCEPTED, Word.COMPLETED)
    await kit.echoed(kit.station.register())
    for number, last in ((1, "completed"), (2, "failed")):
        words = kit.words(message, number, mark)
        expect(words.names in (["accepted", last], [last]), f"drone {number} said accepted, {last}: came {words}")
        wrong = [word for word in words.words if word["session"] != kit.drones[number].session]
        expect(not wrong, f"words of drone {number} in another session: {wrong}")
        expect("relay_stamp" in words.words[0], f"drone {number}: {words} without the activator's stamp")
    rosters = [place for place, result in kit.fog_results(message, mark) if "roster" in result]
    expect(len(rosters) == 1, f"expected one roster, came {len(rosters)}")
    for number in kit.drones:
        every, behind = (kit.words(message, number, place).words for place in (mark, rosters[0]))
        expect(len(behind) == len(every), f"drone {number}: a word came before the roster")
    messages = [heard for heard in kit.cloud.heard[mark:] if "/commands_result/" in heard.topic]
    return f"{', '.join(f'drone {n}: {words}' for n, words in said.items())}; in {len(messages)} messages"


@rule("activator", "R5.12")
async def does_not_broadcast_goto(kit: ActivatorKit) -> str:
    """A goto on fogX/commands is denied, and goes to nobody."""
    message = kit.send(Goto(1.0, 2.0, 10.0), to=None)
    await kit.cloud.until(lambda: kit.fog_results(message), PATIENCE_S)
    await asyncio.sleep(QUIET_S)
    kit.expect_kept(message, "a goto for everybody")
    said = [result.get("denied") for _, result in kit.fog_results(message)]
    expect(len(said) == 1 and said[0], f"expected one denial on fogX/commands_result/goto, came {said}")
    return f"denied: {said[0]}"


@rule("activator", "R5.9")
async def takes_words_of_the_bound_session_only(kit: ActivatorKit) -> str:
    """A word of another session of the drone's number is not passed on."""
    kit.one.words = ()
    message = kit.send(Hold())
    await kit.comes_down(message)
    own, kit.one.session = kit.one.session, secrets.randbelow(2**32 - 1) + 1
    kit.one.say(message.gs_session, message.seq, "hold", Word.COMPLETED)
    kit.one.session = own
    await asyncio.sleep(QUIET_S)
    words = kit.words(message)
    expect(not words.words, f"another session said completed: came {words}")
    kit.one.words = (Word.ACCEPTED, Word.COMPLETED)
    kit.one.say(message.gs_session, message.seq, "hold", Word.COMPLETED)
    words = await kit.outcome(message)
    expect(words.names == ["completed"], f"then the bound session said completed: came {words}")
    return f"another session's completed was dropped; then {words}"
