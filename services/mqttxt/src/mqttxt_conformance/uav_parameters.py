"""Rules of a UAV client about its autopilot's parameters (section 17)."""

from __future__ import annotations

import cbor2

from mqttxt.protocol.commands import SetParameter

from .autopilot import FLOAT, GUARDED, WHOLE
from .autopilot_keeps import INT32, as_value
from .registry import expect, rule
from .uav_kit import UavKit
from .uav_objects import Transfer, in_control, rows_of

_READ_S = 12.0
_NOWHERE = "CONF_NOWHERE"


def _sets(kit: UavKit, mark: int) -> list[tuple[str, int, float]]:
    found = [one.message for one in kit.autopilot.of_type(mark, "PARAM_SET")]
    return [(one.param_id, one.param_type, as_value(one.param_type, one.param_value)) for one in found]


@rule("uav", "R17.6")
async def sets_a_parameter(kit: UavKit) -> str:
    """A parameter is written in its own type and read back; a value that it has already is not written."""
    await kit.calm()
    mark = len(kit.autopilot.written)
    message = kit.send(SetParameter(WHOLE, 3))
    words = await kit.outcome(message)
    sets = _sets(kit, mark)
    expect(sets == [(WHOLE, INT32, 3)], f"{WHOLE} to 3: written {sets}; came {words}")
    kinds = [one.message.get_type() for one in kit.autopilot.written[mark:]]
    expect("PARAM_REQUEST_READ" in kinds[kinds.index("PARAM_SET") :], f"{WHOLE} to 3: not read back; came {words}")
    expect(words.names[-1:] == ["completed"], f"{WHOLE} to 3: came {words}")
    again = kit.send(SetParameter(WHOLE, 3), gs_session=message.gs_session, seq=2)
    then = await kit.outcome(again)
    expect(_sets(kit, mark) == sets, f"{WHOLE}, which is 3, to 3: written again")
    expect(then.names[-1:] == ["completed"], f"{WHOLE}, which is 3, to 3: came {then}")
    return f"{WHOLE} to 3: written once, read back, {words}; again: {then}, not written"


@rule("uav", "R17.7", "R17.9")
async def denies_what_must_not_be_set(kit: UavKit) -> str:
    """Denied unwritten: a parameter that is not there, a fraction for a whole number, one that is not enabled."""
    said = []
    for name, value, reason in (
        (GUARDED, 0.0, "parameter_not_enabled"),
        (GUARDED.lower(), 0.0, "parameter_not_enabled"),
        (WHOLE, 1.5, "wrong_value"),
        (_NOWHERE, 1.0, "unknown_parameter"),
    ):
        await kit.calm()
        mark = len(kit.autopilot.written)
        words, _ = await kit.refused(kit.command(SetParameter(name, value), limit_s=30.0), "denied", reason)
        expect(not _sets(kit, mark), f"{name} to {value:g}: written {_sets(kit, mark)}; came {words}")
        said.append(f"{name} to {value:g}: {words}")
    return f"{'; '.join(said)}; nothing was written"


@rule("uav", "R17.8", "R4.6")
async def sets_no_parameter_late(kit: UavKit) -> str:
    """No PARAM_SET is written after the deadline; where another value is read back the word is `failed(is VALUE)`."""
    await kit.calm()
    kit.autopilot.parameters.takes_none = True
    before = kit.autopilot.parameters.values[FLOAT]
    mark = len(kit.autopilot.written)
    message = kit.send(SetParameter(FLOAT, 2.5), ttl_ms=700, limit_s=30.0)
    words = await kit.outcome(message, 2 * _READ_S)
    written = kit.autopilot.of_type(mark, "PARAM_SET")
    assert message.deadline_ms is not None
    late = [one for one in written if kit.read_late(one.at_ms, message.deadline_ms)]
    expect(written, f"ttl 0.7 s: PARAM_SET was not written; came {words}")
    expect(not late, f"ttl 0.7 s: PARAM_SET after {[one.at_ms - written[0].at_ms for one in written]} ms")
    reason, wanted = str(words.reason), f"is {before[1]:g}"
    expect(words.names[-1:] == ["failed"] and reason.startswith(wanted), f"the value stayed: came {words}")
    return f"ttl 0.7 s, the value stayed: written {len(written)} times, none late; came {words}"


@rule("uav", "R17.1", "R17.3", "R17.5", "R16.4")
async def gives_the_parameters(kit: UavKit) -> str:
    """A station in control gets the whole set; one that has it gets `unchanged`."""
    await kit.calm()
    transfer = Transfer(kit, await in_control(kit), "parameters")
    told = await transfer.newest(_READ_S)
    data = await transfer.whole(told)
    own = [[name, kind, value] for name, (kind, value) in sorted(kit.autopilot.parameters.values.items())]
    rows = rows_of(data, 2)
    expect(rows == own, f"the set {rows}, expected {own}")
    known = cbor2.loads(data)[1]
    name, fields = await transfer.newest(_READ_S, known)
    expect(name == "unchanged" and fields[:1] == [known], f"who has set {known.hex()} gets {name} {fields}")
    return f"{len(rows)} parameters, set {known.hex()}; asked with that: unchanged"
