"""Missions of `sitl` by pymavlink: up, down, flown, refused, cleared.

    missions.py HOST:PORT
"""

import math
import sys

from link import VEHICLE, Link, mavlink

MISSION = mavlink.MAV_MISSION_TYPE_MISSION
GLOBAL = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
AUTO, GUIDED = 3, 4
WAYPOINT = mavlink.MAV_CMD_NAV_WAYPOINT
EARTH_RADIUS_M = 6_378_137.0


def item(seq, point, command=WAYPOINT):
    """An item for `mission_item_int_send`: `point` is latitude and longitude in 1e-7 degrees."""
    latitude, longitude = point
    return [1, VEHICLE, seq, GLOBAL, command, 0, 1, 0, 0, 0, math.nan, latitude, longitude, 100.0, MISSION]


def upload(link, items, announced=None):
    """Uploads items as they are asked for, and returns the acknowledgement."""

    def serve(message):
        if message.get_type() in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and message.seq < len(items):
            link.send.mission_item_int_send(*items[message.seq])
        return message.get_type() == "MISSION_ACK"

    link.send.mission_count_send(1, VEHICLE, len(items) if announced is None else announced, MISSION)
    return link.wait("the end of the upload", serve).type


def download(link):
    """The vehicle's items."""
    count = link.wait_for(
        "MISSION_COUNT", VEHICLE, also=lambda: link.send.mission_request_list_send(1, VEHICLE, MISSION)
    ).count
    items = [
        link.wait_for(
            "MISSION_ITEM_INT",
            VEHICLE,
            also=lambda: link.send.mission_request_int_send(1, VEHICLE, seq, MISSION),
            where=lambda m: m.seq == seq,
        )
        for seq in range(count)
    ]
    link.send.mission_ack_send(1, VEHICLE, mavlink.MAV_MISSION_ACCEPTED, MISSION)
    return items


def main(address):
    link = Link(address)
    version = link.request("AUTOPILOT_VERSION", mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT, version
    here = link.wait_for("GLOBAL_POSITION_INT", VEHICLE)

    def beside(north, east):
        """A point so many metres from here."""
        degrees = math.degrees(1.0 / EARTH_RADIUS_M) * 1e7
        return (
            here.lat + round(north * degrees),
            here.lon + round(east * degrees / math.cos(math.radians(here.lat / 1e7))),
        )

    # Item 0 is home, as with ArduPilot; the way leads round nothing, and back.
    way = [(0, 0), beside(80.0, 0.0), beside(80.0, 40.0)]
    items = [item(seq, point) for seq, point in enumerate(way)]
    assert upload(link, items) == mavlink.MAV_MISSION_ACCEPTED
    stored = download(link)
    assert [(m.x, m.y) for m in stored[1:]] == way[1:], stored
    assert all(m.command == WAYPOINT and m.mission_type == MISSION for m in stored), stored
    print(f"{len(stored)} items up and down again")

    ack = link.command(mavlink.MAV_CMD_DO_SET_MODE, 1, AUTO)
    assert ack.result == mavlink.MAV_RESULT_ACCEPTED, ack
    link.wait_for("HEARTBEAT", VEHICLE, where=lambda m: m.custom_mode == AUTO)
    for seq in (1, 2):
        link.wait_for("MISSION_ITEM_REACHED", VEHICLE, where=lambda m: m.seq == seq)
    there = link.wait_for("GLOBAL_POSITION_INT", VEHICLE)
    (north, east), metre = beside(80.0, 40.0), math.radians(1e-7) * EARTH_RADIUS_M
    error = math.hypot(there.lat - north, (there.lon - east) * math.cos(math.radians(there.lat / 1e7))) * metre
    assert error < 30.0, f"{error} m from the last point"
    print(f"flown: {error:.1f} m from the last point")

    # What is not there, is out of turn or cannot be flown has its own word; the mission stays.
    link.send.mission_request_int_send(1, VEHICLE, 99, MISSION)
    ack = link.wait_for("MISSION_ACK", VEHICLE)
    assert ack.type == mavlink.MAV_MISSION_INVALID_SEQUENCE, ack
    link.send.mission_item_int_send(*items[1])
    ack = link.wait_for("MISSION_ACK", VEHICLE)
    assert ack.type == mavlink.MAV_MISSION_ERROR, ack
    follow = item(1, way[1], command=mavlink.MAV_CMD_NAV_FOLLOW)
    assert upload(link, [items[0], follow]) == mavlink.MAV_MISSION_UNSUPPORTED
    elsewhere = item(1, (900_000_001, 0))
    assert upload(link, [items[0], elsewhere]) != mavlink.MAV_MISSION_ACCEPTED
    assert len(download(link)) == len(items), "a refused mission took the old one's place"

    ack = link.command(mavlink.MAV_CMD_DO_SET_MODE, 1, GUIDED)
    assert ack.result == mavlink.MAV_RESULT_ACCEPTED, ack
    link.send.mission_clear_all_send(1, VEHICLE, MISSION)
    ack = link.wait_for("MISSION_ACK", VEHICLE)
    assert ack.type == mavlink.MAV_MISSION_ACCEPTED, ack
    assert len(download(link)) <= 1, "cleared, and still there"
    ack = link.command(mavlink.MAV_CMD_DO_SET_MODE, 1, AUTO)
    assert ack.result == mavlink.MAV_RESULT_FAILED, ack
    print("ok")


if __name__ == "__main__":
    main(sys.argv[1])
