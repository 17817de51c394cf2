"""An autopilot's parameters are read, given by hash, and set, over all roles, with the stand-in as autopilot."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.effects import Publish
from mqttxt.drone.mavlink.raw import Limits
from mqttxt.drone.options import UavOptions
from mqttxt.drone.role import UavClient
from mqttxt.errors import ConfigurationError
from mqttxt.protocol.bulk import BulkAnswer, Unchanged
from mqttxt.protocol.codec import decode
from mqttxt.protocol.commands import SetParameter
from mqttxt.protocol.messages import Word
from mqttxt.protocol.parameters import PARAMETERS, ParameterSet, ParameterType
from mqttxt.security.rights import SET_PARAMETERS, Rights
from mqttxt.station.signing import CommandSigner
from mqttxt.station.transfers import Fetching
from sitl.personalities import PERSONALITIES
from tests.simulation.flight import Flight
from tests.simulation.signing import seal
from tests.simulation.world import UAV_SESSION
from tests.unit.mqttxt.test_flight_plans import last_word

pytestmark = pytest.mark.long

FLOAT = {"px4": "MPC_XY_CRUISE", "ardupilot": "WPNAV_SPEED"}
WHOLE = {"px4": "RTL_CONE_ANG", "ardupilot": "RTL_LOIT_TIME"}
KIND = {"px4": mavlink.MAV_AUTOPILOT_PX4, "ardupilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA}
OWN_ID = {"px4": "MAV_SYS_ID", "ardupilot": "SYSID_THISMAV"}


class Setter(Flight):
    """A flight that asks for parameters, with the names that its autopilot has."""

    def begin(self, like: str) -> Setter:
        self.like = like
        self.kind = KIND[like]
        super().begin(like)
        return self

    def restart(self, **options: Any) -> None:
        """The UAV client ends, and another one starts."""
        self._options = options
        self.restart_uav(UAV_SESSION + 1, [])
        self.fly(15)
        self.told.clear()

    def _uav(self, session: int, **left: Any) -> UavClient:
        return super()._uav(session, **left, **self._options)

    @property
    def there(self) -> Any:
        """The autopilot's own parameters."""
        return self.vehicle.autopilot.parameters

    def fetch(self, base: ParameterSet | None = None, seconds: float = 5) -> ParameterSet | None:
        """What the drone gives, None where nothing has changed since `base`."""
        fetching = Fetching(self.gs.fog(1), 1, PARAMETERS, base.hash if base is not None else None)
        self.run("gs", self.gs.transfers.begin(fetching, self.now_ms))
        self.fly(seconds)
        assert (fetching.is_over, fetching.error) == (True, None)
        return ParameterSet.unpacked(fetching.data, base) if fetching.data else None

    def fetched(self, base: ParameterSet | None = None) -> ParameterSet:
        found = self.fetch(base)
        assert found is not None
        return found

    def written(self, kind: str) -> list[Any]:
        """What the UAV client has written to its autopilot of a kind of message since the last question."""
        return [message for message in self.told if message.get_type() == kind]

    def __post_init__(self) -> None:
        self._options: dict[str, Any] = {}
        self.told: list[Any] = []
        super().__post_init__()

    def _write(self, effect: Any) -> None:
        self.told.append(effect.message)
        super()._write(effect)

    def answers(self) -> list[Any]:
        """What the drone has said of objects, since the flight began."""
        return [
            decode(BulkAnswer, publish.payload).answer
            for who, publish in self.sent
            if who == "uav" and isinstance(publish, Publish) and publish.topic.endswith("/bulk_answer")
        ]


@pytest.fixture(params=PERSONALITIES)
def flight(request: pytest.FixtureRequest) -> Setter:
    return Setter().begin(request.param)


def test_the_set_has_every_parameter_with_its_type_and_value(flight: Setter) -> None:
    found = flight.fetched()
    assert {one.name: one.value for one in found} == pytest.approx({name: flight.there[name] for name in flight.there})
    assert found.parameters[FLOAT[flight.like]].type is ParameterType.REAL32
    assert found.parameters[WHOLE[flight.like]].type is ParameterType.INT32
    assert OWN_ID[flight.like] in found.parameters


def test_who_has_the_set_gets_one_message_and_the_autopilot_is_not_read_again(flight: Setter) -> None:
    found = flight.fetched()
    flight.sent.clear()
    flight.told.clear()
    assert flight.fetch(found) is None
    assert flight.answers() == [Unchanged(found.hash)]
    assert flight.written("PARAM_REQUEST_LIST") == []


def test_who_has_an_older_set_gets_what_has_changed(flight: Setter) -> None:
    before, name, value = flight.fetched(), WHOLE[flight.like], 75
    assert flight.outcome(SetParameter(name, value)) == (Word.COMPLETED, None)
    flight.sent.clear()
    after = flight.fetched(before)
    assert [one.name for one in after if one != before.parameters[one.name]] == [name]
    assert after.parameters[name].value == value
    assert sum(len(answer.data) for answer in flight.answers() if hasattr(answer, "data")) < 120


@pytest.mark.parametrize(
    ("like", "after_s", "name", "value"),
    [("ardupilot", 61, "WPNAV_SPEED", 444.0), ("px4", 2, "NAV_ACC_RAD", 3.5)],
)
def test_what_another_station_has_set_unheard_shows_in_px4s_hash_and_a_copter_is_read_again_after_a_minute(
    like: str, after_s: float, name: str, value: float
) -> None:
    flight = Setter().begin(like)
    found = flight.fetched()
    flight.fly(after_s)
    flight.there.set(name, value)
    assert flight.fetched(found).parameters[name].value == value


def test_a_client_that_starts_anew_gives_what_has_changed_since(flight: Setter) -> None:
    found = flight.fetched()
    flight.restart(kept_parameters=found)
    assert flight.fetch(found) is None
    assert len(flight.written("PARAM_REQUEST_LIST")) == (0 if flight.like == "px4" else 1)


@pytest.mark.parametrize(
    ("like", "name", "value"),
    [
        ("px4", "MPC_XY_CRUISE", 6.7),
        ("px4", "RTL_CONE_ANG", 7),
        ("px4", "COM_DISARM_LAND", -1.0),
        ("ardupilot", "WPNAV_SPEED", 166.6),
        ("ardupilot", "RTL_LOIT_TIME", 7),
    ],
)
def test_a_parameter_is_set_and_read_back(like: str, name: str, value: float) -> None:
    flight = Setter().begin(like)
    assert flight.outcome(SetParameter(name, value)) == (Word.COMPLETED, None)
    assert flight.there[name] == pytest.approx(value, rel=1e-6)


def test_the_value_that_it_has_is_not_written_again(flight: Setter) -> None:
    name = WHOLE[flight.like]
    assert flight.outcome(SetParameter(name, flight.there[name])) == (Word.COMPLETED, None)
    assert flight.written("PARAM_SET") == []


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("NOBODY_HAS_IT", 1, "unknown_parameter"),
        ("WHOLE", 1.5, "wrong_value, a whole number from -2147483648 to 2147483647"),
        ("WHOLE", 2**31, "wrong_value, a whole number from -2147483648 to 2147483647"),
        ("FLOAT", 1e39, "wrong_value, a number of at most 3.403e+38 in size"),
        ("OWN_ID", 9, "parameter_not_enabled"),
    ],
)
def test_what_cannot_be_set_is_denied_in_a_line(flight: Setter, name: str, value: float, reason: str) -> None:
    name = {"WHOLE": WHOLE, "FLOAT": FLOAT, "OWN_ID": OWN_ID}.get(name, {}).get(flight.like, name)
    assert flight.outcome(SetParameter(name, value)) == (Word.DENIED, reason)
    assert flight.written("PARAM_SET") == []


def test_a_value_that_the_autopilot_does_not_take_is_failed_with_what_it_has() -> None:
    flight = Setter().begin("px4")
    assert flight.outcome(SetParameter("MPC_ACC_HOR", 500)) == (Word.FAILED, "is 3")


def test_a_copters_parameter_in_another_case_is_as_guarded(flight: Setter) -> None:
    assert flight.outcome(SetParameter("sysid_thismav", 9)) == (Word.DENIED, "parameter_not_enabled")


def test_a_guarded_parameter_is_set_where_it_is_enabled(flight: Setter) -> None:
    name = {"px4": "NAV_DLL_ACT", "ardupilot": "FRAME_CLASS"}[flight.like]
    assert flight.outcome(SetParameter(name, 2)) == (Word.DENIED, "parameter_not_enabled")
    flight.restart(options=UavOptions(limits=Limits(parameters=frozenset({name}))))
    assert flight.outcome(SetParameter(name, 2)) == (Word.COMPLETED, None)


def test_a_value_out_of_its_documented_range_is_denied() -> None:
    flight = Setter().begin("px4")
    flight.restart(options=UavOptions(limits=Limits(ranges={"MPC_XY_CRUISE": (3.0, 20.0)})))
    assert flight.outcome(SetParameter("MPC_XY_CRUISE", 2.5)) == (Word.DENIED, "out_of_range, 3 to 20")
    assert flight.written("PARAM_SET") == []
    assert flight.outcome(SetParameter("MPC_XY_CRUISE", 3)) == (Word.COMPLETED, None)


def test_several_are_set_one_after_the_other(flight: Setter) -> None:
    sent = [flight.send(SetParameter(WHOLE[flight.like], value)) for value in (3, 4, 5)]
    flight.fly(5)
    assert [last_word(flight, one) for one in sent] == [(Word.COMPLETED, None)] * 3
    assert flight.there[WHOLE[flight.like]] == 5


def test_one_that_comes_late_is_not_written(flight: Setter) -> None:
    name, before = WHOLE[flight.like], flight.there[WHOLE[flight.like]]
    flight.vehicle.muted = {"PARAM_VALUE"}
    sent = flight.send(SetParameter(name, 8), ttl_ms=1000)
    flight.fly(1.2)
    flight.vehicle.muted = set()
    flight.fly(3)
    assert last_word(flight, sent) == (Word.EXPIRED, None)
    assert flight.there[name] == before


def test_where_nothing_is_read_back_nobody_knows(flight: Setter) -> None:
    name = WHOLE[flight.like]
    sent = flight.send(SetParameter(name, 8))
    while not flight.written("PARAM_SET"):
        flight.fly(0.02)
    flight.vehicle.muted = {"PARAM_VALUE"}
    flight.fly(20)
    assert last_word(flight, sent) == (Word.UNCONFIRMED, "no_ack")


def test_parameters_are_read_and_set_where_messages_are_signed() -> None:
    flight = Setter(signed=True).begin("px4")
    before = flight.fetched()
    assert flight.outcome(SetParameter("RTL_CONE_ANG", 30)) == (Word.COMPLETED, None)
    assert flight.fetched(before).parameters["RTL_CONE_ANG"].value == 30


def test_without_the_right_a_parameter_is_read_and_not_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a station that does not look at its own certificate."""
    rights = Rights(None, take_over=True, upload_plan=True)
    seals = partial(seal, fleet="unset")
    flight = Setter(signed=True, seal=lambda name: seals(name, rights if name == "gs-g" else None)).begin("px4")
    with pytest.raises(ConfigurationError, match=f"certificate has no {SET_PARAMETERS}"):
        flight.send(SetParameter("RTL_CONE_ANG", 30))
    monkeypatch.setattr(CommandSigner, "check_right", lambda *_: None)
    assert flight.outcome(SetParameter("RTL_CONE_ANG", 30)) == (Word.DENIED, f"not_allowed, {SET_PARAMETERS}")
    assert "RTL_CONE_ANG" in flight.fetched().parameters


def test_who_is_not_in_control_is_given_nothing() -> None:
    flight = Setter().begin("px4")
    fetching = Fetching(flight.gs.fog(1), 1, PARAMETERS)
    flight.run("gs", flight.gs.transfers.begin(fetching, flight.now_ms))
    flight.uav.desk.executor.lease.holder_session = 0x99
    flight.fly(5)
    assert not fetching.is_over
    assert "outsiders" in {log.kind for log in flight.logs}


def test_to_set_parameters_is_a_right_of_its_own() -> None:
    command = SetParameter("MPC_XY_CRUISE", 5.0)
    assert Rights(None).missing(command, 1) == SET_PARAMETERS
    assert Rights(None, set_parameters=True).missing(command, 1) is None
    assert Rights(frozenset({2}), set_parameters=True).missing(command, 1) == "mqttxt:may/command/1"
    assert Rights.of_uris(Rights(None, set_parameters=True).uris()) == Rights(None, set_parameters=True)


class Odd(Setter):
    """A flight whose autopilot says something odd of its parameter once that was set: `odd`."""

    odd: Any = None

    def _hear(self, messages: list[Any]) -> None:
        is_set = bool(self.written("PARAM_SET"))
        super()._hear([self.odd if is_set and one.get_type() == "PARAM_VALUE" else one for one in messages])


@pytest.mark.parametrize("like", PERSONALITIES)
@pytest.mark.parametrize("is_error", [False, True])
def test_a_value_that_was_written_is_not_denied_whatever_is_read_back(like: str, is_error: bool) -> None:
    flight, name = Odd(), FLOAT[like].encode()
    flight.begin(like)
    flight.odd = mavlink.MAVLink_param_value_message(name, math.inf, mavlink.MAV_PARAM_TYPE_REAL32, 1, 0)
    if is_error:
        flight.odd = mavlink.MAVLink_param_error_message(0, 0, name, 0, 1)
    reason = "unknown_parameter" if is_error else "not_carried"
    wanted = flight.there[FLOAT[like]] + 1
    assert flight.outcome(SetParameter(FLOAT[like], wanted)) == (Word.UNCONFIRMED, reason)
    assert flight.there[FLOAT[like]] == wanted
