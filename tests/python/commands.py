"""Commands, requests and message intervals of `sitl` by pymavlink.

    commands.py HOST:PORT
"""

import math
import sys

from link import RADIO, VEHICLE, Link, mavlink

ACCEPTED, DENIED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED
UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED
ATTITUDE = mavlink.MAVLINK_MSG_ID_ATTITUDE
GUIDED = 4


def commands(link):
    def send(command, *params, system=1, component=VEHICLE):
        params = list(params) + [0.0] * (7 - len(params))
        link.send.command_long_send(system, component, command, 0, *params)

    # A repeat is acknowledged again; each time to the asker.
    for confirmation in range(3):
        link.send.command_long_send(
            1, VEHICLE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, confirmation, 1, 0, 0, 0, 0, 0, 0
        )
    acks = link.heard_before_pong("COMMAND_ACK")
    assert [ack.result for ack in acks] == [ACCEPTED] * 3, acks
    assert {(ack.target_system, ack.target_component) for ack in acks} == {(250, 190)}, acks

    # Others' commands are met with silence; everybody's are ours, too.
    send(mavlink.MAV_CMD_DO_SET_MODE, 1, GUIDED, system=2)
    send(mavlink.MAV_CMD_DO_SET_MODE, 1, GUIDED, component=42)
    assert link.heard_before_pong("COMMAND_ACK") == []
    send(mavlink.MAV_CMD_DO_SET_MODE, 1, GUIDED, system=0, component=0)
    acks = link.heard_before_pong("COMMAND_ACK")
    assert [(ack.command, ack.result) for ack in acks] == [(mavlink.MAV_CMD_DO_SET_MODE, ACCEPTED)], acks

    # What it does not know it says, in both forms of a command.
    send(31_289)
    link.send.command_int_send(1, VEHICLE, 0, 31_289, 0, 0, 0, 0, 0, 0, 0, 0, 0)
    acks = link.heard_before_pong("COMMAND_ACK")
    assert [(ack.command, ack.result) for ack in acks] == [(31_289, UNSUPPORTED)] * 2, acks
    # In the air it stays armed unless it is forced.
    send(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    acks = link.heard_before_pong("COMMAND_ACK")
    assert len(acks) == 1 and acks[0].result not in (ACCEPTED, UNSUPPORTED), acks
    send(mavlink.MAV_CMD_DO_SET_MODE, 1, math.nan)
    acks = link.heard_before_pong("COMMAND_ACK")
    assert len(acks) == 1 and acks[0].result != ACCEPTED, acks
    print("commands: acknowledged to the asker, each repeat again, nobody else's")


def requests(link):
    for name in ("HOME_POSITION", "GLOBAL_POSITION_INT", "BATTERY_STATUS", "ATTITUDE", "SYS_STATUS"):
        number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        link.request(name, number)
    ack = link.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 11_000)
    assert ack.result == DENIED, ack
    sync = link.wait_for("TIMESYNC", VEHICLE, also=lambda: link.send.timesync_send(0, 12_345))
    assert sync.ts1 == 12_345 and sync.tc1 > 0, sync
    print("requests: answered by the message")


def intervals(link):
    def interval():
        asked = mavlink.MAV_CMD_GET_MESSAGE_INTERVAL
        return link.wait_for(
            "MESSAGE_INTERVAL",
            VEHICLE,
            also=lambda: link.send.command_long_send(1, VEHICLE, asked, 0, ATTITUDE, 0, 0, 0, 0, 0, 0),
            where=lambda m: m.message_id == ATTITUDE,
        ).interval_us

    def set_interval(us):
        return link.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, ATTITUDE, us).result

    def seconds(wanted):
        """How many heartbeats, one a second, come while so many ATTITUDE do."""
        beats, count = 0, 0

        def enough(message):
            nonlocal beats, count
            count += message.get_type() == "ATTITUDE"
            beats += message.get_type() == "HEARTBEAT" and message.get_srcComponent() == VEHICLE
            return count == wanted

        link.wait(f"{wanted} ATTITUDE", enough)
        return beats

    assert interval() == 250_000
    assert set_interval(50_000) == ACCEPTED and interval() == 50_000
    beats = seconds(40)
    assert beats < 8, f"{beats} s for 40 ATTITUDE at 20 Hz; they take 10 s at 4 Hz"
    assert set_interval(-1) == ACCEPTED and interval() == -1
    link.heard_before_pong("ATTITUDE")
    link.wait_for("HEARTBEAT", VEHICLE)
    link.wait_for("SYS_STATUS", VEHICLE)
    assert link.heard_before_pong("ATTITUDE") == [], "switched off, and still there"
    for bad in (1.0, math.nan, math.inf):
        assert set_interval(bad) == DENIED, bad
    assert set_interval(0) == ACCEPTED and interval() == 250_000
    link.send.request_data_stream_send(1, VEHICLE, mavlink.MAV_DATA_STREAM_EXTRA1, 10, 1)
    assert interval() == 100_000
    ack = link.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 11_000, 50_000)
    assert ack.result == DENIED, ack
    print(f"intervals: 40 ATTITUDE in {beats} heartbeats at 20 Hz")


def main(address):
    link = Link(address)
    link.wait_for("HEARTBEAT", VEHICLE)
    link.wait_for("HEARTBEAT", RADIO)
    commands(link)
    requests(link)
    intervals(link)
    print("ok")


if __name__ == "__main__":
    main(sys.argv[1])
