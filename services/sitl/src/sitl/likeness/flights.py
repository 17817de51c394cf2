"""Cases of whole flights: how fast, how high, in how many seconds, and what stops them."""

from __future__ import annotations

from .pilot import Pilot
from .procedures import FLIGHT_S, HEIGHT_M, Procedures, case, down, go, near, up

FLIGHTS: Procedures = {}


@case(FLIGHTS, "takeoff and land")
def _takeoff_and_land(pilot: Pilot) -> None:
    pilot.track()
    up(pilot)
    pilot.land()
    pilot.until("land to 5 m", lambda: pilot.position[2] < 5, FLIGHT_S)
    down(pilot)


@case(FLIGHTS, "goto and return")
def _goto_and_return(pilot: Pilot) -> None:
    go(pilot, 60)
    pilot.until("goto half way", lambda: pilot.position[0] > 30, FLIGHT_S)
    pilot.until("goto to 1 m", near(pilot, 60, HEIGHT_M, 1), FLIGHT_S)
    pilot.until("goto at rest", lambda: pilot.speed_m_s < 0.2, FLIGHT_S)
    pilot.wait(3)
    pilot.set_mode("return")
    pilot.until("return near home", lambda: abs(pilot.position[0]) < 2, FLIGHT_S)
    down(pilot)


@case(FLIGHTS, "return from near")
def _return_from_near(pilot: Pilot) -> None:
    go(pilot, 4)
    pilot.until("goto to 1 m", near(pilot, 4, HEIGHT_M, 1), FLIGHT_S)
    pilot.wait(3)
    pilot.set_mode("return")
    down(pilot)


@case(FLIGHTS, "return at the height of flight")
def _return_at_flight_height(pilot: Pilot) -> None:
    """Fly as the experiments do: return at the height of flight, at the fleet's speed of 12 m/s."""
    before = {name: pilot.parameter(name) for name in pilot.manners.experiments}
    for name, value in pilot.manners.experiments.items():
        pilot.set_parameter(name, value)
    go(pilot, 100)
    pilot.until("goto to 1 m", near(pilot, 100, HEIGHT_M, 1), FLIGHT_S)
    pilot.until("goto at rest", lambda: pilot.speed_m_s < 0.2, FLIGHT_S)
    pilot.set_mode("return")
    pilot.until("return near home", lambda: abs(pilot.position[0]) < 2, FLIGHT_S)
    down(pilot)
    for name, was in before.items():
        if was is not None:
            pilot.set_parameter(name, was)


@case(FLIGHTS, "climb and descend")
def _climb_and_descend(pilot: Pilot) -> None:
    pilot.track()
    up(pilot, 5)
    pilot.goto(0, 0, 25, "climb")
    pilot.until("climb", near(pilot, 0, 25, 1), FLIGHT_S)
    pilot.wait(4)
    pilot.goto(0, 0, 12, "descend")
    pilot.until("descend", near(pilot, 0, 12, 1), FLIGHT_S)
    pilot.wait(4)
    pilot.goto(30, 0, 20, "climb and go")
    pilot.until("climb and go", near(pilot, 30, 20, 1), FLIGHT_S)
    pilot.wait(3)
    pilot.land()
    down(pilot)


@case(FLIGHTS, "stop in a goto")
def _stop_in_a_goto(pilot: Pilot) -> None:
    go(pilot, 150)
    pilot.wait(8)
    pilot.rest()
    pilot.wait(3)
    pilot.case.numbers["speed 3 s after hold"] = round(pilot.speed_m_s, 2)
    pilot.stop_here()
    pilot.until("stop", lambda: pilot.speed_m_s < 0.3, 30)
    pilot.wait(3)
    pilot.set_mode("land")
    down(pilot)


@case(FLIGHTS, "stop in a takeoff")
def _stop_in_a_takeoff(pilot: Pilot) -> None:
    pilot.track()
    pilot.arm()
    pilot.takeoff(30)
    pilot.until("takeoff to 6 m", lambda: pilot.position[2] > 6, FLIGHT_S)
    pilot.rest()
    pilot.wait(5)
    pilot.case.numbers["height after hold"] = round(pilot.position[2], 1)
    pilot.takeoff(12)
    pilot.wait(8)
    pilot.stop_here()
    pilot.wait(2)
    pilot.land()
    down(pilot)


@case(FLIGHTS, "offboard, and its client ends")
def _offboard(pilot: Pilot) -> None:
    pilot.track()
    pilot.set_mode("offboard")
    pilot.wait(2)
    pilot.arm()
    pilot.rest()
    pilot.wait(2)
    up(pilot)
    pilot.set_mode("offboard")
    pilot.wait(3)
    pilot.rest()
    pilot.wait(2)
    pilot.repeat = lambda: pilot.velocity(2, 0, 0)
    pilot.wait(1)
    pilot.set_mode("offboard")
    pilot.until("offboard", lambda: pilot.mode == "offboard", 5)
    pilot.wait(6)
    pilot.case.numbers["offboard speed"] = round(pilot.last["LOCAL_POSITION_NED"].vx, 2)
    pilot.repeat = None
    mode = pilot.mode
    pilot.until("", lambda: pilot.mode != mode, 10)
    pilot.wait(3)
    pilot.rest()
    pilot.wait(3)
    pilot.land()
    down(pilot)


@case(FLIGHTS, "velocity, and its client ends")
def _velocity(pilot: Pilot) -> None:
    pilot.track()
    pilot.repeat = lambda: pilot.velocity(0, 0, -1)
    pilot.arm()
    pilot.wait(4)
    pilot.case.numbers["height after a velocity on the ground"] = round(pilot.position[2], 1)
    pilot.repeat = None
    pilot.wait(1)
    up(pilot)
    pilot.repeat = lambda: pilot.velocity(2, 0, 0)
    pilot.wait(6)
    pilot.case.numbers["velocity's speed"] = round(pilot.last["LOCAL_POSITION_NED"].vx, 2)
    pilot.repeat = None
    pilot.mark()
    pilot.until("slower", lambda: pilot.speed_m_s < 1, 30)
    pilot.until("stands", lambda: pilot.speed_m_s < 0.3, 30)
    pilot.wait(3)
    pilot.land()
    down(pilot)
