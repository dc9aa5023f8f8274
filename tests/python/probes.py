"""Sixty probes of a vehicle in the air: what `sitl` answers, beside what ArduCopter's and PX4's sources answer.

    probes.py HOST:PORT        prints the table of docs/probes.md

`sitl` flies in an open world. The answers of the autopilots are read from their sources, not measured: a
letter names the file, docs/probes.md its commit. `not known` is what those files do not tell.
"""

import math
import sys
import time

from link import VEHICLE, Link, mavlink

ACK = "COMMAND_ACK"
COPTER_GUIDED = 4
# Texts of one kind are a second apart.
TEXT_PAUSE_S = 1.2
LATITUDE, LONGITUDE = 47.397742, 8.545594


def long(number, *params, system=1, component=VEHICLE):
    params = [*params, *[0.0] * 7][:7]
    return lambda link: link.send.command_long_send(system, component, number, 0, *params)


def place(number, *params, x=int(LATITUDE * 1e7), y=int(LONGITUDE * 1e7), z=40.0):
    params = [*params, *[0.0] * 4][:4]
    relative = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT
    return lambda link: link.send.command_int_send(1, VEHICLE, relative, number, 0, 0, *params, x, y, z)


def setpoint(frame, mask, *numbers):
    numbers = [*numbers, *[0.0] * 11][:11]
    return lambda link: link.send.set_position_target_local_ned_send(0, 1, VEHICLE, frame, mask, *numbers)


def param_set(name, value):
    return lambda link: link.send.param_set_send(1, VEHICLE, name, value, mavlink.MAV_PARAM_TYPE_REAL32)


def param_read(name, index=-1):
    return lambda link: link.send.param_request_read_send(1, VEHICLE, name, index)


cmd = mavlink
POSITION, VELOCITY = 0x0DF8, 0x0DC7
ATTITUDE = mavlink.MAVLINK_MSG_ID_ATTITUDE
NONE = 11_000
OK, NO, WRONG = "ACCEPTED", "DENIED", "FAILED"
LATER, LACKS = "TEMPORARILY_REJECTED", "UNSUPPORTED"
UNKNOWN = "not known"

# What is asked; how; ArduCopter; PX4; messages that are listened for beside the acknowledgement.
PROBES = [
    ("arm, armed", long(cmd.MAV_CMD_COMPONENT_ARM_DISARM, 1), f"{OK} b", UNKNOWN),
    ("disarm, in the air", long(cmd.MAV_CMD_COMPONENT_ARM_DISARM, 0), f"{WRONG} c", f"{LATER} p"),
    ("COMPONENT_ARM_DISARM 2", long(cmd.MAV_CMD_COMPONENT_ARM_DISARM, 2), f"{LACKS} b", "nothing p"),
    ("DO_SET_MODE, its own mode of setpoints", long(cmd.MAV_CMD_DO_SET_MODE, 1, COPTER_GUIDED), f"{OK} b", f"{OK} p"),
    ("DO_SET_MODE, custom mode 99", long(cmd.MAV_CMD_DO_SET_MODE, 1, 99), f"{WRONG} b", f"{OK}, no change p"),
    ("DO_SET_MODE, base mode 0", long(cmd.MAV_CMD_DO_SET_MODE, 0, 0), f"{NO} b", f"{OK}, no change p"),
    ("SET_MODE (message 11)", lambda link: link.send.set_mode_send(1, 1, COPTER_GUIDED), f"{OK} of command 11 b", f"{OK} of command 176 p, q"),
    ("NAV_TAKEOFF 20 m, in the air", long(cmd.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 20), f"{WRONG} d", f"{OK} p"),
    ("NAV_TAKEOFF as COMMAND_INT above the sea", lambda link: link.send.command_int_send(1, VEHICLE, 0, cmd.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 0, 600), f"{NO} a", f"{OK} p"),
    ("NAV_LAND", long(cmd.MAV_CMD_NAV_LAND), f"{OK} a", f"{OK} p"),
    ("NAV_RETURN_TO_LAUNCH", long(cmd.MAV_CMD_NAV_RETURN_TO_LAUNCH), f"{OK} a", f"{OK} p"),
    ("NAV_LOITER_UNLIM", long(cmd.MAV_CMD_NAV_LOITER_UNLIM), f"{OK} a", f"{LACKS} p"),
    ("DO_REPOSITION, COMMAND_INT, mode change allowed", place(cmd.MAV_CMD_DO_REPOSITION, -1, 1), f"{OK} a", f"{OK} p"),
    ("DO_REPOSITION, COMMAND_INT, mode change not allowed", place(cmd.MAV_CMD_DO_REPOSITION, -1, 0), f"{OK} in GUIDED, else {NO} a", f"{LACKS} p"),
    ("DO_REPOSITION, COMMAND_LONG", long(cmd.MAV_CMD_DO_REPOSITION, -1, 1, 0, 0, LATITUDE, LONGITUDE, 530), f"{LACKS} b", f"{OK} p"),
    ("DO_REPOSITION to latitude 100", place(cmd.MAV_CMD_DO_REPOSITION, -1, 1, x=1_000_000_000), f"{NO} a", f"{OK} p"),
    ("DO_CHANGE_SPEED 5 m/s", long(cmd.MAV_CMD_DO_CHANGE_SPEED, 1, 5), f"{OK} or {WRONG}, by mode a", UNKNOWN),
    ("DO_CHANGE_SPEED -1", long(cmd.MAV_CMD_DO_CHANGE_SPEED, 1, -1), f"{NO} a", UNKNOWN),
    ("DO_CHANGE_SPEED 0", long(cmd.MAV_CMD_DO_CHANGE_SPEED, 1, 0), f"{NO} a", UNKNOWN),
    ("CONDITION_YAW 90", long(cmd.MAV_CMD_CONDITION_YAW, 90, 0, 1), f"{OK} a", f"{LACKS} p"),
    ("CONDITION_YAW 400", long(cmd.MAV_CMD_CONDITION_YAW, 400), f"{WRONG} a", f"{LACKS} p"),
    ("DO_PAUSE_CONTINUE 0", long(cmd.MAV_CMD_DO_PAUSE_CONTINUE, 0), f"{OK} or {WRONG}, by mode a", f"{LACKS} p"),
    ("DO_PAUSE_CONTINUE 2", long(cmd.MAV_CMD_DO_PAUSE_CONTINUE, 2), f"{NO} a", f"{LACKS} p"),
    ("MISSION_START, no mission", long(cmd.MAV_CMD_MISSION_START), UNKNOWN, f"{NO} p"),
    ("MISSION_START from item 1", long(cmd.MAV_CMD_MISSION_START, 1), f"{NO} a", f"{NO} without a mission p"),
    ("DO_SET_MISSION_CURRENT 99, not there", long(cmd.MAV_CMD_DO_SET_MISSION_CURRENT, 99), f"{NO} b", f"{LACKS} p"),
    ("DO_ORBIT", long(cmd.MAV_CMD_DO_ORBIT, 20, 2), f"{LACKS} a, b", f"{OK} p"),
    ("DO_CHANGE_ALTITUDE", long(cmd.MAV_CMD_DO_CHANGE_ALTITUDE, 50, 3), f"{LACKS} a, b", f"{OK} p"),
    ("DO_SET_HOME, here", long(cmd.MAV_CMD_DO_SET_HOME, 1), f"{OK} b", f"{OK} p"),
    ("DO_SET_ROI_NONE", long(cmd.MAV_CMD_DO_SET_ROI_NONE), UNKNOWN, UNKNOWN),
    ("DO_SET_SERVO", long(cmd.MAV_CMD_DO_SET_SERVO, 9, 1500), UNKNOWN, f"{LACKS} p"),
    ("DO_FLIGHTTERMINATION 0", long(cmd.MAV_CMD_DO_FLIGHTTERMINATION, 0), UNKNOWN, f"{NO} p"),
    ("PREFLIGHT_REBOOT_SHUTDOWN 0", long(cmd.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 0), f"{WRONG} b", f"{OK} p"),
    ("PREFLIGHT_REBOOT_SHUTDOWN 99", long(cmd.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 99), f"{WRONG} b", f"{NO} p"),
    ("PREFLIGHT_CALIBRATION, gyro", long(cmd.MAV_CMD_PREFLIGHT_CALIBRATION, 1), f"{WRONG} b", f"{LATER} p"),
    ("PREFLIGHT_STORAGE 0", long(cmd.MAV_CMD_PREFLIGHT_STORAGE, 0), f"{NO} b", f"{LATER} p"),
    ("RUN_PREARM_CHECKS", long(cmd.MAV_CMD_RUN_PREARM_CHECKS), f"{LATER} b", f"{OK} p"),
    ("GET_HOME_POSITION", long(cmd.MAV_CMD_GET_HOME_POSITION), f"{OK}, HOME_POSITION b", f"{OK}, HOME_POSITION q", "HOME_POSITION"),
    ("REQUEST_PROTOCOL_VERSION", long(cmd.MAV_CMD_REQUEST_PROTOCOL_VERSION), f"{LACKS} b", f"{OK}, PROTOCOL_VERSION q", "UNKNOWN_300"),
    ("REQUEST_AUTOPILOT_CAPABILITIES 1", long(cmd.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1), f"{OK}, AUTOPILOT_VERSION b", f"{OK}, AUTOPILOT_VERSION q", "AUTOPILOT_VERSION"),
    ("REQUEST_AUTOPILOT_CAPABILITIES 0", long(cmd.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 0), f"{WRONG} b", f"{OK}, AUTOPILOT_VERSION q", "AUTOPILOT_VERSION"),
    ("REQUEST_MESSAGE 148", long(cmd.MAV_CMD_REQUEST_MESSAGE, 148), f"{OK}, AUTOPILOT_VERSION b", f"{OK}, AUTOPILOT_VERSION q", "AUTOPILOT_VERSION"),
    ("REQUEST_MESSAGE 11000, not there", long(cmd.MAV_CMD_REQUEST_MESSAGE, NONE), f"{WRONG} b", f"{NO} q"),
    ("SET_MESSAGE_INTERVAL 30, 0.1 s", long(cmd.MAV_CMD_SET_MESSAGE_INTERVAL, ATTITUDE, 100_000), f"{OK} b", f"{OK} q"),
    ("SET_MESSAGE_INTERVAL 30, 10 µs", long(cmd.MAV_CMD_SET_MESSAGE_INTERVAL, ATTITUDE, 10), f"{OK}, 1 ms b", UNKNOWN),
    ("SET_MESSAGE_INTERVAL 11000, not there", long(cmd.MAV_CMD_SET_MESSAGE_INTERVAL, NONE, 100_000), f"{NO} b", f"{WRONG} q"),
    ("GET_MESSAGE_INTERVAL 30", long(cmd.MAV_CMD_GET_MESSAGE_INTERVAL, ATTITUDE), f"{OK}, MESSAGE_INTERVAL b", f"{OK}, MESSAGE_INTERVAL q", "MESSAGE_INTERVAL"),
    ("GET_MESSAGE_INTERVAL 11000, not there", long(cmd.MAV_CMD_GET_MESSAGE_INTERVAL, NONE), f"{WRONG}, MESSAGE_INTERVAL b", UNKNOWN, "MESSAGE_INTERVAL"),
    ("a command that nobody has, 31289", long(31_289), f"{LACKS} b", f"{LACKS} p"),
    ("a command for another system", long(cmd.MAV_CMD_DO_SET_MODE, 1, COPTER_GUIDED, system=2), UNKNOWN, f"{WRONG} q"),
    ("a command for a component that is not there", long(cmd.MAV_CMD_DO_SET_MODE, 1, COPTER_GUIDED, component=42), UNKNOWN, f"{WRONG} q"),
    ("velocity setpoint, LOCAL_OFFSET_NED", setpoint(7, VELOCITY, 0, 0, 0, 1, 0, 0), "taken a", "STATUSTEXT q", "STATUSTEXT"),
    ("velocity setpoint, BODY_NED", setpoint(8, VELOCITY, 0, 0, 0, 1, 0, 0), "taken a", "taken q", "STATUSTEXT"),
    ("position setpoint, frame 20", setpoint(20, POSITION, 1, 1, -1), "stops, without a word a", "STATUSTEXT q", "STATUSTEXT"),
    ("acceleration setpoint with the force bit", setpoint(1, 0x0E3F, 0, 0, 0, 0, 0, 0, 1, 0, 0), "stops, without a word a", UNKNOWN, "STATUSTEXT"),
    ("setpoint whose mask ignores all", setpoint(1, 0x0DFF), "stops, without a word a", UNKNOWN, "STATUSTEXT"),
    ("velocity setpoint of NaN", setpoint(1, VELOCITY, 0, 0, 0, math.nan, 0, 0), "stops, without a word a", "taken as ignored q", "STATUSTEXT"),
    ("PARAM_REQUEST_READ, a name that is not there", param_read(b"NO_SUCH_THING"), "nothing e", "nothing r", "PARAM_VALUE", "PARAM_ERROR"),
    ("PARAM_SET, a name that is not there", param_set(b"NO_SUCH_THING", 1.0), "nothing e", "STATUSTEXT r", "PARAM_VALUE", "PARAM_ERROR", "STATUSTEXT"),
    ("TIMESYNC, tc1 0", lambda link: link.send.timesync_send(0, 12_345), "TIMESYNC b", UNKNOWN, "TIMESYNC"),
]  # fmt: skip


def result(message):
    """What a message tells: acknowledgements sort before all others."""
    if message.get_type() == ACK:
        name = mavlink.enums["MAV_RESULT"][message.result].name
        return 0, name.removeprefix("MAV_RESULT_")
    # pymavlink has no name for this one.
    return 1, "PROTOCOL_VERSION" if message.get_type() == "UNKNOWN_300" else message.get_type()


def answer(link, ask, kinds):
    """What comes before the answer to a PING that was sent behind the question."""
    link.pings += 1
    heard = []

    def pong(message):
        if message.get_type() in kinds:
            heard.append(result(message))
        return message.get_type() == "PING" and message.seq == link.pings

    ask(link)
    link.send.ping_send(int(time.time() * 1e6), link.pings, 0, 0)
    link.wait("the answer to a PING", pong)
    return ", ".join(word for _, word in sorted(set(heard))) or "nothing"


def drain(link, seconds):
    end = time.monotonic() + seconds
    link.wait("a pause", lambda _: time.monotonic() > end)


def main(address):
    link = Link(address)
    link.wait_for("HEARTBEAT", VEHICLE)
    print("| | what is asked | ArduCopter | PX4 | `sitl` |\n|---|---|---|---|---|")
    for number, (what, ask, copter, px4, *kinds) in enumerate(PROBES, 1):
        ack = link.command(mavlink.MAV_CMD_DO_SET_MODE, 1, COPTER_GUIDED)
        assert ack.result == mavlink.MAV_RESULT_ACCEPTED, ack
        if "STATUSTEXT" in kinds:
            drain(link, TEXT_PAUSE_S)
        told = answer(link, ask, {ACK, *kinds})
        if kinds == ["STATUSTEXT"] and told == "nothing":
            told = "taken"
        print(f"| {number} | {what} | {copter} | {px4} | {told} |")
    assert number == 60, number


if __name__ == "__main__":
    main(sys.argv[1])
