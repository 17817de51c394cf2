"""A command that has begun is not written once its station has lost control, or the process ends (R5.4, R5.14)."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from mqttxt.core.effects import Inbound
from mqttxt.core.settings import Settings
from mqttxt.drone.effects import Journal, Transmit
from mqttxt.drone.paths import Paths
from mqttxt.drone.role import UavClient
from mqttxt.protocol.codec import encode
from mqttxt.protocol.commands import (
    Arm,
    ClearPlan,
    Command,
    Goto,
    Hold,
    Land,
    Offboard,
    SetCurrentItem,
    SetParameter,
    StartMission,
    Takeoff,
    Velocity,
)
from mqttxt.protocol.control import DroneLease
from mqttxt.protocol.messages import CommandId, Word
from tests.simulation.signed import signed_command, signed_world, to_drone
from tests.simulation.signing import seal
from tests.simulation.workbench import LAND, MODE, REPOSITION, TAKEOFF, Bench, said, set_points, written
from tests.simulation.world import (
    FOG_SESSION,
    GS_SESSION,
    UAV_SESSION,
    ack,
    command_payload,
    from_autopilot,
    heartbeat,
    home,
    landed,
    on_disk,
    position,
    ready,
    transmitted,
)
from tests.unit.mqttxt.test_mission_starts import HASH, PX4_HOLD, PX4_MISSION, Planned
from tests.unit.mqttxt.test_uav_client import client, hear, lease, words

GROUND, AIR = 1, 2
ANOTHER = 9
NORTHWARDS = Offboard(duration_s=60.0, velocity=Velocity(5.0, 0.0, 0.0))
HERE, THERE = Goto(47.4, 8.5, 20), Goto(47.41, 8.5, 20)
REFUSED = [(Word.DENIED, "not_in_control")]


def value(name: str, is_now: float) -> Any:
    return from_autopilot(mavlink.MAVLink_param_value_message(name.encode(), is_now, 9, 10, 3))


def controlled(*told: Any) -> UavClient:
    """A drone that the station controls."""
    uav = client()
    for message in told:
        uav.on_mavlink(message, 1000)
    lease(uav, 1000, epoch=0, holder_session=GS_SESSION, deadline_ms=30_000, counter=1)
    return uav


def flying() -> UavClient:
    return controlled(heartbeat(armed=True), position(20.0), landed(AIR))


def sent(uav: UavClient, command: Command, seq: int = 1) -> list[int | str]:
    """What is written for a command, by number or kind."""
    out = hear(uav, command_payload(command, seq=seq), 1100)
    for one in transmitted(out):
        uav.on_transmitted(one.ref, 1100)
    return kinds(out)


def kinds(out: list[Any]) -> list[int | str]:
    messages = [one.message for one in out if isinstance(one, Transmit)]
    return [getattr(message, "command", message.get_type()) for message in messages]


def pass_on(uav: UavClient, epoch: int) -> None:
    """Another station has the drone: it took it (a higher epoch), or it was free and is the other's now."""
    lease(uav, 1200, epoch=epoch, holder_session=ANOTHER, deadline_ms=30_000, counter=2)


@pytest.mark.parametrize("epoch", [0, 1])
def test_what_waits_for_its_number_is_not_written_for_a_former_holder(epoch: int) -> None:
    uav = flying()
    assert sent(uav, HERE) == [REPOSITION]
    assert sent(uav, THERE, seq=2) == []
    pass_on(uav, epoch)
    out = uav.on_mavlink(ack(REPOSITION), 1300) + uav.tick(1400)
    assert transmitted(out) == []
    assert words(out) == [(Word.ACCEPTED, None), *REFUSED]


@pytest.mark.parametrize(("epoch", "said"), [(0, [(Word.ACCEPTED, None)]), (1, [(Word.ACCEPTED, None), *REFUSED])])
def test_a_lease_that_names_nobody_ends_what_waits_under_a_higher_epoch_alone(epoch: int, said: Any) -> None:
    """Without a higher epoch its station's registration has lapsed, and a command has a deadline of its own."""
    uav = flying()
    assert sent(uav, HERE) == [REPOSITION]
    assert sent(uav, THERE, seq=2) == []
    lease(uav, 1200, epoch=epoch, counter=2)
    assert words(uav.on_mavlink(ack(REPOSITION), 1300) + uav.tick(1400)) == said


@pytest.mark.parametrize("epoch", [0, 1])
def test_an_arm_behind_its_hold_is_not_written_for_a_former_holder(epoch: int) -> None:
    uav = controlled(heartbeat(main=4, sub=4))
    assert sent(uav, Arm()) == [MODE]
    pass_on(uav, epoch)
    out = uav.on_mavlink(ack(MODE), 1250) + uav.on_mavlink(heartbeat(main=4, sub=3), 1300) + uav.tick(1400)
    assert transmitted(out) == []
    assert words(out) == [(Word.FAILED, "not_in_control")], "its hold may have changed the mode"


@pytest.mark.parametrize(("command", "number"), [(Takeoff(10.0), TAKEOFF), (Land(), LAND)])
def test_nothing_is_written_again_for_a_former_holder(command: Command, number: int) -> None:
    uav = controlled(heartbeat(armed=True), position(0.0), landed(GROUND))
    assert sent(uav, command) == [number]
    pass_on(uav, 1)
    out = [one for now_ms in range(1300, 3200, 100) for one in uav.tick(now_ms)]
    assert transmitted(out) == []
    assert words(out) == [(Word.UNCONFIRMED, "no_ack")]


def test_while_its_station_has_control_a_command_is_written_again_though_the_lease_is_late() -> None:
    uav = controlled(heartbeat(armed=True), position(0.0), landed(GROUND))
    lease(uav, 1050, epoch=0, holder_session=GS_SESSION, deadline_ms=1150, counter=2)
    assert sent(uav, Land()) == [LAND]
    assert LAND in kinds([one for now_ms in range(1200, 1800, 100) for one in uav.tick(now_ms)])


def test_a_station_that_has_just_taken_over_is_obeyed_before_its_lease_comes() -> None:
    uav = client()
    uav.on_mavlink(heartbeat(armed=True), 1000)
    lease(uav, 1000, epoch=0, holder_session=ANOTHER, deadline_ms=30_000, counter=1)
    assert kinds(hear(uav, command_payload(Land(), epoch=1), 1100)) == [LAND]


def test_epochs_of_two_activator_sessions_do_not_compare() -> None:
    """The new session has no records, and begins with epoch 0."""
    uav = flying()
    lease(uav, 1050, epoch=5, holder_session=GS_SESSION, deadline_ms=30_000, counter=2)
    for seq, command in enumerate((HERE, THERE), start=1):
        out = hear(uav, command_payload(command, seq=seq, epoch=5), 1100)
    assert kinds(out) == []
    lease(uav, 1200, activator_session=10, epoch=0, holder_session=ANOTHER, deadline_ms=30_000, counter=1)
    out = [*uav.on_mavlink(ack(REPOSITION), 1300), *uav.tick(1400)]
    assert transmitted(out) == []
    assert words(out) == [(Word.ACCEPTED, None), *REFUSED]


def test_who_was_led_by_an_earlier_activator_session_is_not_obeyed_for_its_epoch() -> None:
    """Its command stood in a connection; the new session's leases name another station, then this one."""
    uav = flying()
    lease(uav, 1050, epoch=5, holder_session=GS_SESSION, deadline_ms=30_000, counter=2)
    lease(uav, 1100, activator_session=10, epoch=0, holder_session=ANOTHER, deadline_ms=30_000, counter=1)
    assert words(hear(uav, command_payload(HERE, seq=1, epoch=5), 1200)) == REFUSED
    lease(uav, 1300, activator_session=10, epoch=1, holder_session=GS_SESSION, deadline_ms=30_000, counter=2)
    assert kinds(hear(uav, command_payload(HERE, seq=2, epoch=1), 1400)) == [REPOSITION]


def test_an_epoch_is_no_excuse_where_messages_are_signed() -> None:
    """A station may sign any epoch."""
    world = signed_world()
    uav, now_ms = world.uav, world.now_ms
    for message in (heartbeat(armed=True), position(0.0), landed(GROUND)):
        uav.on_mavlink(message, now_ms)
    command = signed_command(command=Takeoff(10.0), epoch=2**32 - 1, deadline_ms=now_ms + 5000)
    (takeoff,) = transmitted(on_disk(uav, to_drone(world, command), now_ms))
    uav.on_transmitted(takeoff.ref, now_ms)
    taken = DroneLease(
        activator_session=FOG_SESSION,
        drone_session=UAV_SESSION,
        nonce=5,
        bound=True,
        epoch=1,
        counter=1000,
        heard_ms=now_ms,
        holder="h",
        holder_session=ANOTHER,
        deadline_ms=now_ms + 30_000,
    )
    signed = seal("fog1").sign("drone1/init_connect", encode(taken)).encode()
    uav.on_message("fog", Inbound("drone1/init_connect", signed, 1), now_ms + 100)
    out = [one for later_ms in range(200, 3000, 100) for one in uav.tick(now_ms + later_ms)]
    assert transmitted(out) == []


def test_who_gets_the_drone_back_under_a_newer_epoch_has_control() -> None:
    uav = flying()
    assert sent(uav, Land()) == [LAND]
    lease(uav, 1200, epoch=1, holder_session=GS_SESSION, deadline_ms=30_000, counter=2)
    assert LAND in kinds([one for now_ms in range(1300, 1800, 100) for one in uav.tick(now_ms)])


@pytest.mark.parametrize("until_ms", [30_000, 1250])
def test_a_parameter_that_waits_is_not_set_for_a_former_holder(until_ms: int) -> None:
    """The other station's lease may be over when the parameter could be set."""
    uav = controlled()
    sent(uav, SetParameter("MPC_XY_CRUISE", 5.0))
    lease(uav, 1200, epoch=0, holder_session=ANOTHER, deadline_ms=until_ms, counter=2)
    out = uav.on_mavlink(value("MPC_XY_CRUISE", 3.0), 1300)
    assert "PARAM_SET" not in kinds(out)
    assert words(out) == REFUSED


@pytest.mark.parametrize(("holder", "until_ms"), [(ANOTHER, 60_000), (1, 100)])
def test_set_points_that_precede_offboard_end_with_the_lease(holder: int, until_ms: int) -> None:
    bench = Bench(heartbeat(armed=True), home(), position(20.0), landed(AIR))
    held = bench.executor.lease
    held.until_ms, held.offboard_until_ms, held.holder_session = 60_000, 60_000, 1
    assert written(bench.start(1, NORTHWARDS)) == []
    held.until_ms, held.offboard_until_ms, held.holder_session = until_ms, until_ms, holder
    out = bench.until(2000, 50)
    assert said(out) == [(1, Word.DENIED, "no_lease")]
    assert written(out) == []
    assert len(set_points(out)) <= until_ms / 50


def test_offboard_that_is_written_and_not_acknowledged_is_ended_with_the_lease() -> None:
    bench = Bench(heartbeat(armed=True), home(), position(20.0), landed(AIR))
    held = bench.executor.lease
    held.until_ms, held.offboard_until_ms, held.holder_session = 60_000, 60_000, 1
    out = bench.start(1, NORTHWARDS) + bench.until(600, 50)
    assert written(out) == [MODE]
    held.holder_session = ANOTHER
    out = bench.until(1000, 50) + bench.hear(heartbeat(armed=True))
    assert {message.param2 for message in modes(out)} == {4.0}, "hold alone"
    assert said(out) == [(1, Word.FAILED, "lease_lost")]


def modes(out: list[Any]) -> list[Any]:
    return [one.message for one in out if isinstance(one, Transmit) and getattr(one.message, "command", 0) == MODE]


def test_a_superseded_start_sets_no_item() -> None:
    """The hold comes between the list's last item and the next tick."""
    bench = Planned(PX4_HOLD, 0)
    out = bench.start(1, StartMission(HASH, 3)) + bench.until(bench.now_ms + 100)
    while True:
        answers = [one for each in out if isinstance(each, Transmit) for one in bench.answers_to(each.message)]
        if answers[-1].get_type() == "MISSION_ITEM_INT" and answers[-1].seq == len(bench.items) - 1:
            break
        out = bench.hear(*map(from_autopilot, answers))
    assert (1, Word.SUPERSEDED, None) in said(bench.start(2, Hold()))
    assert "MISSION_SET_CURRENT" not in kinds(bench.hear(*map(from_autopilot, answers)))


def test_a_process_that_ends_sets_no_item() -> None:
    bench = Planned(PX4_MISSION, 0)
    out = bench.start(1, SetCurrentItem(HASH, 3))
    bench.executor.leave(bench.now_ms)
    out = bench.answered(out) + bench.until(bench.now_ms + 3000)
    assert "MISSION_SET_CURRENT" not in kinds(out)


def test_a_process_that_ends_sets_no_parameter_that_it_has_read() -> None:
    bench = Bench()
    bench.start(1, SetParameter("MPC_XY_CRUISE", 5.0))
    bench.executor.leave(bench.now_ms)
    out = bench.hear(value("MPC_XY_CRUISE", 3.0)) + bench.until(bench.now_ms + 3000)
    assert "PARAM_SET" not in kinds(out)


def test_a_process_that_ends_sets_no_parameter_that_waits() -> None:
    bench = Bench()
    bench.start(1, SetParameter("MPC_XY_CRUISE", 5.0))
    bench.start(2, SetParameter("MPC_Z_VEL_MAX_UP", 2.0))
    bench.executor.leave(bench.now_ms)
    out = bench.hear(value("MPC_XY_CRUISE", 5.0), value("MPC_Z_VEL_MAX_UP", 3.0)) + bench.until(3000)
    assert "PARAM_SET" not in kinds(out)
    assert said(out) == [(1, Word.COMPLETED, None)], "the value was there; the next session closes the other one"


def test_a_refusal_that_waits_for_a_text_is_said_before_the_process_ends() -> None:
    uav = flying()
    assert sent(uav, HERE) == [REPOSITION]
    assert words(uav.on_mavlink(ack(REPOSITION, 1), 1200)) == []
    last = [one for one in uav.goodbye(1250) if isinstance(one, Journal)]
    assert [(one.word, one.reason) for one in last] == [(Word.DENIED, "temporarily_rejected")]


def test_a_takeoff_that_was_never_written_undoes_no_pilots_mode() -> None:
    bench = Bench(heartbeat(armed=True), home(), position(0.0), landed(GROUND))
    assert written(bench.start(1, Takeoff(10.0), deadline_ms=50)) == [TAKEOFF]
    bench.executor.on_refused(CommandId(1, 1), True, 100)
    bench.until(2000)
    out = bench.hear(heartbeat(armed=False, main=4, sub=2)) + bench.until(4000)
    assert written(out) == []


def test_no_list_is_changed_behind_a_start_that_nobody_knows_of() -> None:
    bench = Planned(PX4_HOLD, 0)
    out = bench.begin(StartMission(HASH, 1)) + bench.until(bench.now_ms + 4000)
    assert said(out)[-1] == (1, Word.UNCONFIRMED, "no_ack")
    out = bench.answered(bench.start(2, ClearPlan()) + bench.until(bench.now_ms + 300))
    assert said(out) == [(2, Word.DENIED, "mission_running")]
    assert "MISSION_CLEAR_ALL" not in kinds(out)


def test_once_its_first_connection_is_lost_a_client_takes_another_activator_over_the_second() -> None:
    paths = Paths("first", 10_000)
    leases = [DroneLease(activator_session=one, drone_session=1, nonce=1, bound=True, epoch=0) for one in (9, 10)]
    assert paths.takes(leases[0], "first", 1000)
    assert not paths.takes(leases[1], "second", 2000)
    paths.on_lost("second")
    assert not paths.takes(leases[1], "second", 2000)
    paths.on_lost("first")
    assert paths.takes(leases[1], "second", 2000)


def test_a_lease_of_an_earlier_activator_that_stood_in_a_connection_changes_nothing() -> None:
    """The first connection stands still with a lease in it; another activator session leads the drone meanwhile."""
    uav = UavClient(1, UAV_SESSION, Settings(), paths=Paths("first", 10_000))
    ready(uav, 1000)

    def led(now_ms: int, path: str, holder: int, counter: int, activator: int) -> None:
        given = DroneLease(
            activator_session=activator,
            drone_session=UAV_SESSION,
            nonce=counter,
            bound=True,
            epoch=activator - 9,
            holder_session=holder,
            deadline_ms=now_ms + 30_000,
            counter=counter,
        )
        uav.on_message("fog", Inbound("drone1/init_connect", encode(given), 1, path=path), now_ms)

    led(1000, "first", GS_SESSION, 1, 9)
    led(8000, "second", GS_SESSION, 2, 9)
    for counter, now_ms in enumerate(range(42_000, 60_000, 2000), start=1):
        led(now_ms, "second", ANOTHER, counter, 10)
    assert uav.executor.lease.holder_session == ANOTHER
    led(60_000, "first", GS_SESSION, 2, 9)
    for counter, now_ms in enumerate(range(60_100, 100_000, 2000), start=50):
        assert uav.executor.lease.holder_session == ANOTHER
        led(now_ms, "second", ANOTHER, counter, 10)
        assert uav.is_controlled(now_ms)
    assert (uav.executor.lease.holder_session, uav.desk.holder.epoch) == (ANOTHER, 1)
