"""The whole set is read whatever is lost, changed, restarted or odd meanwhile, and only what is whole is given."""

from __future__ import annotations

import math
import random
import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.drone.effects import Transmit
from mqttxt.drone.mavlink.parameter_protocol import BEGINNINGS, SetReading, parameter_of, set_message
from mqttxt.drone.mavlink.plans import CannotExecute
from mqttxt.drone.mavlink.px4 import Px4
from mqttxt.drone.mavlink.vehicle import Vehicle
from mqttxt.drone.parameter_copy import ParameterCopy
from mqttxt.errors import PayloadError
from mqttxt.protocol.bulk import Unchanged
from mqttxt.protocol.parameters import MOST_PARAMETERS, Parameter, ParameterSet, ParameterType
from tests.simulation.world import from_autopilot, heartbeat

REAL32, INT32, INT8 = ParameterType.REAL32, ParameterType.INT32, ParameterType.INT8
COUNT = 1400


def value(name: bytes, carried: float, index: int, total: int, kind: int = REAL32) -> Any:
    return from_autopilot(mavlink.MAVLink_param_value_message(name, carried, kind, total, index))


def whole(bits: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", bits))[0])


class Autopilot:
    """A PX4 with so many parameters, behind a link that loses messages both ways; `told` is what it was asked."""

    def __init__(self, count: int, loss: float = 0.0) -> None:
        self.values = {f"P{number:04}": float(number % 97) + 0.25 for number in range(count)}
        self.loss, self._rng = loss, random.Random(5)
        self.told: list[Any] = []

    def answer(self, asked: Any) -> list[Any]:
        self.told.append(asked)
        if self._is_lost():
            return []
        names = list(self.values)
        wanted: list[str]
        if asked.get_type() == "PARAM_REQUEST_LIST":
            wanted = names
        elif asked.param_index >= 0:
            wanted = names[asked.param_index : asked.param_index + 1]
        else:
            wanted = [name for name in names if name == asked.param_id]
        return [one for one in map(self.message, wanted) if not self._is_lost()]

    def message(self, name: str) -> Any:
        return value(name.encode(), self.values[name], int(name[-4:]), len(self.values))

    def _is_lost(self) -> bool:
        return self._rng.random() < self.loss


class Bench:
    """A copy of an autopilot's parameters, in time."""

    def __init__(self, autopilot: Autopilot, kept: ParameterSet | None = None) -> None:
        self.autopilot = autopilot
        self.vehicle = Vehicle(1)
        self.now_ms = 0
        self.copy = ParameterCopy(self.vehicle, kept)
        self.hear(heartbeat())

    def hear(self, *messages: Any) -> None:
        for message in messages:
            self.vehicle.update(message, self.now_ms)
            self.carry(self.copy.on_message(message, self.now_ms))

    def carry(self, outputs: list[Any]) -> None:
        for output in outputs:
            assert isinstance(output, Transmit)
            self.hear(*self.autopilot.answer(output.message))

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds * 10)):
            self.now_ms += 100
            if self.now_ms % 1000 == 0:
                self.hear(heartbeat())
            self.carry(self.copy.tick(self.now_ms))

    def fetch(self, limit_s: float = 60, known: bytes | None = None) -> bytes | str | Unchanged:
        for _ in range(round(limit_s * 10)):
            found = self.copy.fetch(self.now_ms, known)
            if found is not None:
                return found
            self.pass_time(0.1)
        raise AssertionError("nothing in time")

    def values(self) -> dict[str, float | None]:
        found = self.fetch()
        assert isinstance(found, bytes)
        return {one.name: one.value for one in ParameterSet.unpacked(found)}


@pytest.fixture
def reading() -> SetReading:
    """A reading of a PX4's set that has begun."""
    begun = SetReading(1, bytewise=True)
    begun.begin(0)
    return begun


@pytest.mark.parametrize("loss", [0.0, 0.05, 0.3])
def test_every_parameter_is_read_over_a_link_that_loses(loss: float) -> None:
    bench = Bench(Autopilot(COUNT, loss))
    assert bench.values() == bench.autopilot.values
    lists = [asked for asked in bench.autopilot.told if asked.get_type() == "PARAM_REQUEST_LIST"]
    assert len(lists) <= (1 if loss < 0.1 else 3)


def test_what_another_station_sets_meanwhile_is_in_the_set() -> None:
    bench = Bench(Autopilot(50))
    autopilot, late = bench.autopilot, bench.autopilot.message("P0007")
    bench.values()
    autopilot.values["P0007"] = 3.5
    bench.hear(value(b"P0007", 3.5, 65_535, 50))  # as ArduPilot says it: without its place in the list
    assert bench.values()["P0007"] == 3.5
    bench.hear(late)
    assert bench.values()["P0007"] == late.param_value


def test_a_change_while_the_list_is_read_is_in_the_set(reading: SetReading) -> None:
    for index in range(3):
        reading.on_value(value(f"P{index}".encode(), 1.0, index, 4), 0)
    reading.on_value(value(b"P1", 9.0, 65_535, 4), 0)
    reading.on_value(value(b"UNLISTED", 5.0, 65_535, 4), 0)
    reading.on_value(value(b"P3", 1.0, 3, 4), 0)
    assert reading.found is not None
    assert {one.name: one.value for one in reading.found} == {"P0": 1.0, "P1": 9.0, "P2": 1.0, "P3": 1.0}


def test_a_value_out_of_no_parameters_is_no_whole_set(reading: SetReading) -> None:
    reading.on_value(value(b"A", 1.0, 65_535, 0), 0)
    assert not reading.is_over
    reading.on_value(value(b"A", 1.0, 0, 1), 0)
    assert reading.found is not None
    assert [one.name for one in reading.found] == ["A"]


@pytest.mark.parametrize(
    ("read", "other", "names"),
    [
        ([value(b"A", 1.0, 0, 2)], value(b"C", 1.0, 1, 3), (b"A", b"B", b"C")),
        # NEW has come in front of B, and C has gone.
        ([value(b"A", 1.0, 0, 3), value(b"B", 1.0, 1, 3)], value(b"B", 1.0, 2, 3), (b"A", b"NEW", b"B")),
    ],
    ids=["another number of parameters", "places that move"],
)
def test_a_list_that_changes_while_it_is_read_begins_anew(
    reading: SetReading, read: list[Any], other: Any, names: tuple[bytes, ...]
) -> None:
    for one in read:
        reading.on_value(one, 0)
    (again,) = reading.on_value(other, 10)
    assert again.get_type() == "PARAM_REQUEST_LIST"
    for index, name in enumerate(names):
        assert reading.found is None
        reading.on_value(value(name, 2.0, index, 3), 20)
    assert reading.found is not None
    assert [one.name for one in reading.found] == sorted(name.decode() for name in names)


def test_more_names_than_parameters_begin_the_list_anew_and_are_not_kept() -> None:
    reading = SetReading(1, bytewise=True)
    asked = reading.begin(0)
    most = 0
    for number in range(20 * BEGINNINGS):
        asked += reading.on_value(value(f"X{number}".encode(), 1.0, 65535, 10), 0)
        most = max(most, len(reading._named))
    assert most <= 11
    assert len(asked) == BEGINNINGS
    assert reading.error == "changed_meanwhile"


def test_a_list_that_never_settles_is_given_up(reading: SetReading) -> None:
    for total in range(10, 10 + BEGINNINGS + 1):
        reading.on_value(value(b"A", 1.0, 0, total), 0)
    assert reading.error == "changed_meanwhile"


@pytest.mark.parametrize("total", [MOST_PARAMETERS + 1, 65_535])
def test_more_than_there_may_be_are_refused(reading: SetReading, total: int) -> None:
    reading.on_value(value(b"A", 1.0, 0, total), 0)
    assert reading.error == f"too_many, {total}"


def test_an_autopilot_that_answers_nothing_is_said_to() -> None:
    bench = Bench(Autopilot(10, loss=1.0))
    assert bench.fetch() == "no_answer"
    bench.autopilot.loss = 0.0
    bench.pass_time(2)
    assert bench.values() == bench.autopilot.values


def test_one_that_is_never_told_is_no_set() -> None:
    bench = Bench(Autopilot(10))
    told = bench.autopilot.message
    bench.autopilot.message = lambda name: told(name if name != "P0003" else "P0002")  # type: ignore[method-assign]
    assert bench.fetch() == "no_answer"


def test_an_autopilot_that_starts_anew_while_it_is_read_is_read_anew() -> None:
    bench = Bench(Autopilot(30))
    bench.hear(_booted(100_000))
    answer, bench.autopilot.answer = bench.autopilot.answer, lambda asked: []  # type: ignore[method-assign]
    assert bench.copy.fetch(bench.now_ms) is None
    bench.pass_time(0.1)
    bench.hear(*(bench.autopilot.message(f"P{number:04}") for number in range(20)))
    bench.autopilot.answer = answer  # type: ignore[method-assign]
    bench.autopilot.values = dict.fromkeys(bench.autopilot.values, 1.0)
    bench.now_ms += 1000
    bench.hear(_booted(500))
    assert bench.values() == bench.autopilot.values


def test_a_set_of_before_a_start_is_not_given() -> None:
    bench = Bench(Autopilot(30))
    bench.hear(_booted(100_000))
    bench.values()
    bench.autopilot.values["P0001"] = 77.0
    bench.now_ms += 1000
    bench.hear(_booted(500), heartbeat())
    assert bench.values()["P0001"] == 77.0


def _booted(time_ms: int) -> Any:
    return from_autopilot(mavlink.MAVLink_system_time_message(0, time_ms))


# -- names, types and values -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [b"caf\xe9", b"A B", b"\xff\xff", b"", b"A\nB", b"A/B"])
def test_a_name_with_odd_bytes_is_left_out_and_ends_no_reading(reading: SetReading, name: bytes) -> None:
    reading.on_value(value(name, 1.0, 0, 2), 0)
    reading.on_value(value(b"GOOD", 1.0, 1, 2), 0)
    assert reading.found is not None
    assert [one.name for one in reading.found] == ["GOOD"]


def test_a_name_of_sixteen_characters_is_whole() -> None:
    found = parameter_of(value(b"ABCDEFGHIJKLMNOP", 1.0, 0, 1), bytewise=True)
    assert found == Parameter("ABCDEFGHIJKLMNOP", REAL32, 1.0)


@pytest.mark.parametrize(("carried", "kind"), [(math.inf, REAL32), (-math.inf, REAL32), (1.0, 8), (1.0, 10), (1.0, 99)])
def test_what_has_no_form_is_left_out(carried: float, kind: int) -> None:
    assert parameter_of(value(b"ODD", carried, 0, 1, kind), bytewise=True) is None


def test_nan_is_a_value_of_its_own() -> None:
    found = parameter_of(value(b"ODD", math.nan, 0, 1), bytewise=True)
    assert found == Parameter("ODD", REAL32, None)
    packed = ParameterSet.of([Parameter("ODD", REAL32, math.nan)]).packed()
    assert ParameterSet.unpacked(packed).parameters["ODD"] == found


@pytest.mark.parametrize("number", [0, 1, -1, 10_040, 2**31 - 1, -(2**31), 0x7F800001, -8_388_607, -4_194_304])
def test_bytes_that_are_no_number_are_still_a_whole_number(number: int) -> None:
    frame = bytearray(value(b"WHOLE", 1.0, 0, 1, INT32).get_msgbuf())
    frame[10:14] = struct.pack("<i", number)
    payload = mavlink.MAVLink_param_value_message(b"WHOLE", 1.0, INT32, 1, 0)
    payload._msgbuf = frame
    assert parameter_of(payload, bytewise=True) == Parameter("WHOLE", INT32, number)


def test_an_autopilot_of_the_other_manner_carries_whole_numbers_as_numbers() -> None:
    assert parameter_of(value(b"WHOLE", -5.0, 0, 1, INT8), bytewise=False) == Parameter("WHOLE", INT8, -5)
    assert parameter_of(value(b"WHOLE", 0.5, 0, 1, INT8), bytewise=False) is None
    assert set_message(1, Parameter("WHOLE", INT8, -5), bytewise=False).param_value == -5.0
    with pytest.raises(CannotExecute, match="not_carried, 16777217"):
        set_message(1, Parameter("WHOLE", INT32, 2**24 + 1), bytewise=False)


def test_a_whole_number_whose_bytes_a_float_would_change_is_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    written = set_message(1, Parameter("WHOLE", INT32, -1), bytewise=True)
    assert struct.pack("<f", written.param_value) == b"\xff\xff\xff\xff"
    quieted = Parameter("WHOLE", INT32, -8_388_607)
    monkeypatch.setattr(struct, "unpack", lambda form, data: (math.nan,))  # as floats are that go through 64 bits
    with pytest.raises(CannotExecute, match="not_carried, -8388607"):
        set_message(1, quieted, bytewise=True)


@pytest.mark.parametrize(
    ("kind", "number"), [(INT8, 128), (INT8, -129), (INT8, 0.5), (ParameterType.UINT32, -1), (INT32, None)]
)
def test_a_value_that_its_type_does_not_have_is_refused(kind: ParameterType, number: float | None) -> None:
    with pytest.raises(PayloadError, match=r"^A: expected a whole number from -?\d+ to \d+, got "):
        Parameter("A", kind, number)


# -- hashes ------------------------------------------------------------------------------------------------------------


def test_the_set_is_named_by_what_it_has_and_not_by_its_order() -> None:
    some = [Parameter("B", INT8, 1), Parameter("A", REAL32, 2.0)]
    assert ParameterSet.of(some).hash == ParameterSet.of(reversed(some)).hash
    assert ParameterSet.of(some).hash != ParameterSet.of(some[:1]).hash


def test_changes_of_a_set_that_is_not_there_are_refused() -> None:
    before = ParameterSet.of([Parameter("A", REAL32, 1.0), Parameter("GONE", REAL32, 1.0)])
    after = ParameterSet.of([Parameter("A", REAL32, 2.0), Parameter("NEW", INT8, 3)])
    changes = after.packed(before)
    assert ParameterSet.unpacked(changes, before) == after
    for other in (None, after):
        with pytest.raises(PayloadError, match="expected changes of a set that is there"):
            ParameterSet.unpacked(changes, other)


def test_what_is_more_than_the_whole_is_given_as_the_whole() -> None:
    before = ParameterSet.of(Parameter(f"THE_OLD_ONE_{number:04}", INT32, number) for number in range(1900))
    bench = Bench(Autopilot(1900), kept=before)
    bench.autopilot.values = {f"THE_NEW_ONE_{number:04}": float(number) + 0.0625 for number in range(1900)}
    with pytest.raises(PayloadError, match="at most 61440 bytes before compression"):
        ParameterSet.of(Parameter(name, REAL32, number) for name, number in bench.autopilot.values.items()).packed(
            before
        )
    found = bench.fetch(known=before.hash)
    assert isinstance(found, bytes)
    assert len(ParameterSet.unpacked(found)) == 1900


def test_a_hash_that_lies_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    some = ParameterSet.of([Parameter("A", REAL32, 1.0)])
    monkeypatch.setattr(ParameterSet, "hash", bytes(16))
    lying = some.packed()
    monkeypatch.undo()
    with pytest.raises(PayloadError, match=r"expected set 0{32}, got [0-9a-f]{32}"):
        ParameterSet.unpacked(lying)


def test_px4s_hash_is_over_names_and_values_but_for_what_px4_changes_itself() -> None:
    some = [Parameter("MPC_XY_CRUISE", REAL32, 5.0), Parameter("NAV_DLL_ACT", INT32, -1)]
    number = Px4().hash_check(ParameterSet.of(some))
    assert number == 0x6887A881
    volatile = [Parameter("CAL_MAG0_XOFF", REAL32, 0.5), Parameter("LND_FLIGHT_T_LO", INT32, 7)]
    assert Px4().hash_check(ParameterSet.of([*some, *volatile])) == number


def test_a_parameter_that_is_told_before_the_first_heartbeat_ends_nothing() -> None:
    kept = ParameterSet.of([Parameter("A", INT8, 5)])
    copy = ParameterCopy(Vehicle(1), kept)
    assert copy.on_message(value(b"A", 1.0, 0, 1), 0) == []
    assert copy.newest_given == kept


def test_a_kept_set_that_is_not_the_autopilots_is_read_anew() -> None:
    autopilot = Autopilot(30)
    bench = Bench(autopilot, kept=ParameterSet.of([Parameter("P0001", REAL32, 5.0)]))
    assert bench.values() == autopilot.values
