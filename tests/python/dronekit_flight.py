"""Flies `sitl` by DroneKit: waits until it is ready, changes modes, pushes north, flies a mission.

    dronekit_flight.py HOST:PORT
"""

import math
import os
import sys
import time

# Without this DroneKit sends mission items as MAVLink 1, which `sitl` counts and leaves alone.
os.environ["MAVLINK20"] = "1"

from dronekit import Command, LocationGlobalRelative, VehicleMode, connect  # noqa: E402
from pymavlink import mavutil  # noqa: E402

mavlink = mavutil.mavlink
# Reached only by a failure; a busy machine needs less.
PATIENCE_S = 120.0


def until(what, holds):
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline, f"waited {PATIENCE_S} s for {what}"
        time.sleep(0.05)


def mode(vehicle, name):
    vehicle.mode = VehicleMode(name)
    until(f"mode {name}", lambda: vehicle.mode.name == name)


def main(address):
    vehicle = connect(f"udpout:{address}", wait_ready=True, timeout=PATIENCE_S)
    assert vehicle.armed and vehicle.mode.name == "GUIDED" and vehicle.gps_0.fix_type == 3, vehicle.mode
    here = vehicle.location.local_frame
    assert math.isclose(here.north, 250.0) and math.isclose(here.east, 50.0), here
    vehicle.parameters["RATE_ATTITUDE"] = 8
    until("RATE_ATTITUDE", lambda: vehicle.parameters["RATE_ATTITUDE"] == 8)
    print(f"ready, {len(vehicle.parameters)} parameters")

    push = vehicle.message_factory.set_position_target_local_ned_encode(
        0, 1, 1, mavlink.MAV_FRAME_LOCAL_NED, 3135, 0, 0, 0, 0, 0, 0, 5.0, 0, 0, 0, 0
    )

    def moved():
        vehicle.send_mavlink(push)
        return vehicle.location.local_frame.north > 260.0

    until("a move north", moved)
    assert vehicle.velocity[0] > 0.0, vehicle.velocity
    mode(vehicle, "BRAKE")
    until("standing still", lambda: abs(vehicle.velocity[0]) < 0.1)
    mode(vehicle, "GUIDED")
    print(f"pushed north to {vehicle.location.local_frame.north:.1f} m, and braked")

    there = vehicle.location.global_relative_frame
    goal = LocationGlobalRelative(there.lat + math.degrees(20.0 / 6_378_137.0), there.lon, 60.0)
    before = vehicle.location.local_frame.north
    vehicle.simple_goto(goal)
    until("the goal of simple_goto", lambda: vehicle.location.local_frame.north > before + 19.0)
    until("its height", lambda: abs(vehicle.location.global_relative_frame.alt - 60.0) < 0.5)
    print(f"went to {vehicle.location.local_frame.north:.1f} m, 60 m high")

    there = vehicle.location.global_relative_frame
    north = LocationGlobalRelative(there.lat + math.degrees(50.0 / 6_378_137.0), there.lon, there.alt)
    before = vehicle.location.local_frame.north
    commands = vehicle.commands
    commands.download()
    commands.wait_ready()
    commands.clear()
    commands.add(
        Command(
            0, 0, 0, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_CMD_NAV_WAYPOINT,
            0, 1, 0, 0, 0, 0, north.lat, north.lon, north.alt,
        )
    )  # fmt: skip
    commands.upload(timeout=PATIENCE_S)
    mode(vehicle, "AUTO")
    until("the waypoint", lambda: vehicle.location.local_frame.north > before + 40.0)
    print(f"flew the mission to {vehicle.location.local_frame.north:.1f} m")
    vehicle.close()
    print("ok")


if __name__ == "__main__":
    main(sys.argv[1])
