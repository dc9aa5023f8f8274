"""A pytest of somebody's companion computer behind `sitl`: pytest examples/python/test_companion.py

The companion here is a few lines of pymavlink. The vehicle is the program `sitl`, built before
(cargo build --release -p crpl-sitl), or named by SITL. pip install pymavlink pytest.
"""

import os
import socket
import subprocess
import time

import pytest
from pymavlink import mavutil

SITL = os.environ.get("SITL", "target/release/sitl")
ACCELERATION_ONLY = 0b110000111111


@pytest.fixture
def vehicle():
    """A vehicle in flight, and a link to it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    program = subprocess.Popen([SITL, "--listen", f"udpin:127.0.0.1:{port}", "--pace", "realtime", "--speed", "20"])
    try:
        link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=255)
        until = time.monotonic() + 60
        while link.wait_heartbeat(timeout=0.5) is None:
            assert program.poll() is None and time.monotonic() < until
            link.mav.heartbeat_send(mavutil.mavlink.MAV_TYPE_GCS, mavutil.mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        yield link
    finally:
        program.terminate()
        program.wait(timeout=30)


def companion(link, north, east):
    """Your code: one acceleration, m/s²."""
    link.mav.set_position_target_local_ned_send(
        0, 1, 1, mavutil.mavlink.MAV_FRAME_LOCAL_NED,
        ACCELERATION_ONLY, 0, 0, 0, 0, 0, 0, north, east, 0, 0, 0,
    )  # fmt: skip


def test_the_companion_flies_east(vehicle):
    begin = vehicle.recv_match(type="LOCAL_POSITION_NED", blocking=True, timeout=60)
    until = time.monotonic() + 60
    while time.monotonic() < until:
        companion(vehicle, 0.0, 1.0)
        now = vehicle.recv_match(type="LOCAL_POSITION_NED", blocking=True, timeout=1)
        if now and now.y > begin.y + 20:
            return
    pytest.fail("the vehicle has not moved east")
