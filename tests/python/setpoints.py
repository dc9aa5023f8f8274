"""Setpoints as tutorials send them: pymavlink's position and velocity examples, and a flight anywhere on Earth.

    setpoints.py HOST:PORT

`sitl` stands on the ground, in an open world, at ArduPilot's home in Canberra.
"""

import math
import sys

from link import VEHICLE, Link, mavlink

HOME = (-35.363261, 149.165230, 584.0)
METRES_PER_DEGREE = 111_319.49
POSITION, VELOCITY = 0x0DF8, 0x0DC7
ACCEPTED = mavlink.MAV_RESULT_ACCEPTED


def local(link, mask, frame, position=(0, 0, 0), velocity=(0, 0, 0)):
    link.send.set_position_target_local_ned_send(0, 1, VEHICLE, frame, mask, *position, *velocity, 0, 0, 0, 0, 0)


def reach(link, what, holds, also):
    link.wait_for("LOCAL_POSITION_NED", VEHICLE, also=also, where=holds)
    print(what)


def main(address):
    link = Link(address)
    link.wait_for("HEARTBEAT", VEHICLE)
    there = link.request("GLOBAL_POSITION_INT", mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert abs(there.lat / 1e7 - HOME[0]) < 1e-5 and abs(there.lon / 1e7 - HOME[1]) < 1e-5, there
    assert there.relative_alt == 0 and abs(there.alt / 1e3 - HOME[2]) < 1 and there.hdg == 35_300, there

    assert link.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 20).result != ACCEPTED, "not armed"
    assert link.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1).result == ACCEPTED
    assert link.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 20).result == ACCEPTED
    reach(link, "took off to 20 m", lambda m: abs(m.z + 20) < 0.5, lambda: None)

    ned = mavlink.MAV_FRAME_LOCAL_NED
    reach(
        link,
        "flew to a position",
        lambda m: math.dist((m.x, m.y, m.z), (40, -30, -30)) < 1,
        lambda: local(link, POSITION, ned, (40, -30, -30)),
    )
    reach(
        link,
        "flew at a velocity",
        lambda m: m.x > 60 and abs(m.vx - 5) < 0.2 and abs(m.vz + 1) < 0.2,
        lambda: local(link, VELOCITY, ned, velocity=(5, 0, -1)),
    )
    link.send.command_long_send(1, VEHICLE, mavlink.MAV_CMD_CONDITION_YAW, 0, 90, 0, 1, 0, 0, 0, 0)
    link.wait_for("ATTITUDE", VEHICLE, where=lambda m: abs(m.yaw - math.pi / 2) < 0.01)
    reach(
        link,
        "flew forward, which is east",
        lambda m: m.y > 0 and abs(m.vy - 4) < 0.2 and abs(m.vx) < 0.2,
        lambda: local(link, VELOCITY, mavlink.MAV_FRAME_BODY_OFFSET_NED, velocity=(4, 0, 0)),
    )
    # 1 km to the north, on Earth.
    latitude = HOME[0] + 1000 / METRES_PER_DEGREE
    reach(
        link,
        "flew a kilometre on Earth",
        lambda m: math.dist((m.x, m.y, m.z), (1000, 0, -50)) < 2,
        lambda: link.send.set_position_target_global_int_send(
            0, 1, VEHICLE, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, POSITION,
            int(latitude * 1e7), int(HOME[1] * 1e7), 50, 0, 0, 0, 0, 0, 0, 0, 0,
        ),
    )  # fmt: skip
    # A reset between two scripts.
    assert link.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1).result == ACCEPTED
    reach(link, "rebooted on the ground", lambda m: (m.x, m.y, m.z) == (0, 0, 0), lambda: None)
    print("ok")


if __name__ == "__main__":
    main(sys.argv[1])
