"""Parameters and a mission through a radio at the edge of its range, by pymavlink: slow, and whole in the end.

    link_edge.py HOST:PORT

Asks as ground stations do: for what is missing, again, about once a second.
"""

import math
import sys
import time

from link import VEHICLE, Link, mavlink

MISSION = mavlink.MAV_MISSION_TYPE_MISSION
GLOBAL = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
PERIOD_S = 1.5
SILENCE_S = 4.0


def paced(ask):
    """Asks at once and then every PERIOD_S, however often it is called."""
    last = [-math.inf]

    def also():
        if time.monotonic() - last[0] >= PERIOD_S:
            last[0] = time.monotonic()
            ask()

    return also


def parameters(link):
    """All parameters of the vehicle: the list, then what of it is missing."""
    found = {}

    def ask():
        if not found:
            link.send.param_request_list_send(1, VEHICLE)
            return
        count = next(iter(found.values())).param_count
        for index in [index for index in range(count) if index not in found][:10]:
            link.send.param_request_read_send(1, VEHICLE, b"", index)

    def done(message):
        if message.get_type() == "PARAM_VALUE" and message.get_srcComponent() == VEHICLE:
            if message.param_index < message.param_count:
                found[message.param_index] = message
        return len(found) > 0 and len(found) == next(iter(found.values())).param_count

    link.wait("all parameters", done, also=paced(ask))
    return found


def upload(link, items):
    """Uploads items as they are asked for. Where the vehicle has not asked for a while, its last word was lost or it
    has given up, and the upload begins again."""
    asked = [-math.inf]

    def begin():
        if time.monotonic() - asked[-1] > SILENCE_S:
            link.send.mission_count_send(1, VEHICLE, len(items), MISSION)

    def serve(message):
        if message.get_type() in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            asked.append(time.monotonic())
            link.send.mission_item_int_send(*items[message.seq])
        return message.get_type() == "MISSION_ACK" and message.type == mavlink.MAV_MISSION_ACCEPTED

    link.wait("the end of the upload", serve, also=paced(begin))


def download(link):
    """The vehicle's items, each asked for until it comes."""
    ask = paced(lambda: link.send.mission_request_list_send(1, VEHICLE, MISSION))
    count = link.wait_for("MISSION_COUNT", VEHICLE, also=ask).count
    items = []
    for seq in range(count):
        ask = paced(lambda seq=seq: link.send.mission_request_int_send(1, VEHICLE, seq, MISSION))
        items.append(link.wait_for("MISSION_ITEM_INT", VEHICLE, also=ask, where=lambda m, seq=seq: m.seq == seq))
    link.send.mission_ack_send(1, VEHICLE, mavlink.MAV_MISSION_ACCEPTED, MISSION)
    return items


def main(address):
    link = Link(address)
    link.wait_for("RADIO_STATUS", mavlink.MAV_COMP_ID_TELEMETRY_RADIO)
    found = parameters(link)
    print(f"{len(found)} parameters")

    here = link.wait_for("GLOBAL_POSITION_INT", VEHICLE)
    items = [
        [1, VEHICLE, seq, GLOBAL, mavlink.MAV_CMD_NAV_WAYPOINT, 0, 1, 0, 0, 0, math.nan]
        + [here.lat + 1000 * seq, here.lon, 100.0, MISSION]
        for seq in range(6)
    ]
    upload(link, items)
    back = download(link)
    # Item 0 is home.
    assert [m.x for m in back][1:] == [item[11] for item in items][1:], back
    print(f"{len(back)} items up and down")
    # Its acknowledgement crosses the radio before the end.
    link.wait_for("HEARTBEAT", VEHICLE)
    print("ok")


main(sys.argv[1])
