"""Flies `sitl` with nothing but pymavlink: pushes the UAV north, raises the radio's power, saves a frame.

    pip install pymavlink
    cargo run --release -p crpl-sitl                       # in another terminal
    python examples/fly_north.py 127.0.0.1:14550 frame.png

North is the y of the unit square and a frame's row, east its x and a frame's column; a unit is 500 m.
"""

import os
import sys
import time

os.environ["MAVLINK20"] = "1"  # before the import: SNR and frames come as MAVLink 2

from pymavlink import mavutil  # noqa: E402

mavlink = mavutil.mavlink

VEHICLE, RADIO = mavlink.MAV_COMP_ID_AUTOPILOT1, mavlink.MAV_COMP_ID_TELEMETRY_RADIO
ACCELERATION_ONLY = 3135  # type_mask: ignore position, speed, down, yaw
SET_TX_POWER = mavlink.MAV_CMD_USER_1


class Uav:
    def __init__(self, address):
        self.link = mavutil.mavlink_connection(f"udpout:{address}", dialect="common", source_system=250)
        self.beat = 0.0

    def accelerate(self, north, east):
        """Sets the acceleration, m/s2. The UAV holds it until the next one comes."""
        self.link.mav.set_position_target_local_ned_send(
            0, 1, VEHICLE, mavlink.MAV_FRAME_LOCAL_NED, ACCELERATION_ONLY,
            0, 0, 0, 0, 0, 0, north, east, 0, 0, 0,
        )  # fmt: skip

    def set_power(self, level):
        """Sets the base station's transmit power: 1 or 4."""
        self.link.mav.command_long_send(1, RADIO, SET_TX_POWER, 0, level, 0, 0, 0, 0, 0, 0)

    def messages(self, seconds):
        """All messages of the next `seconds`, as they come. Meanwhile our heartbeat goes out."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            if time.monotonic() > self.beat + 1.0:
                self.beat = time.monotonic()
                self.link.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
            message = self.link.recv_match(blocking=True, timeout=0.1)
            if message is not None:
                yield message

    def wait_for(self, kind, where=lambda message: True, seconds=60.0):
        """The next message of this kind for which `where` holds."""
        for message in self.messages(seconds):
            if message.get_type() == kind and where(message):
                return message
        raise TimeoutError(f"no {kind} from the vehicle in {seconds} s")

    def snr_db(self):
        """The SNR of the next control interval, dB."""
        return self.wait_for("NAMED_VALUE_FLOAT", lambda m: m.name == "SNR_DB").value

    def frame(self):
        """One camera frame, the bytes of a PNG."""
        request = mavlink.MAV_CMD_REQUEST_MESSAGE
        number = mavlink.MAVLINK_MSG_ID_DATA_TRANSMISSION_HANDSHAKE
        self.link.mav.command_long_send(1, VEHICLE, request, 0, number, 0, 0, 0, 0, 0, 0)
        head = self.wait_for("DATA_TRANSMISSION_HANDSHAKE", lambda m: m.packets > 0)
        chunks = {}
        while len(chunks) < head.packets:
            chunk = self.wait_for("ENCAPSULATED_DATA")
            chunks[chunk.seqnr] = bytes(chunk.data)[: head.payload]
        return b"".join(chunks[i] for i in range(head.packets))[: head.size]


def main(address, path):
    uav = Uav(address)
    start = uav.wait_for("LOCAL_POSITION_NED")
    print(f"at north {start.x:.1f} m, east {start.y:.1f} m")

    uav.accelerate(5.0, 0.0)
    moved = uav.wait_for("LOCAL_POSITION_NED", lambda m: m.x > start.x + 10.0)
    print(f"pushed: north {moved.x:.1f} m at {moved.vx:.1f} m/s")

    uav.accelerate(-5.0, 0.0)
    slow = uav.wait_for("LOCAL_POSITION_NED", lambda m: m.vx <= 0.0)
    uav.accelerate(0.0, 0.0)
    print(f"braked: north {slow.x:.1f} m")

    low = uav.snr_db()
    uav.set_power(4.0)
    uav.wait_for("NAMED_VALUE_FLOAT", lambda m: m.name == "TXP" and m.value == 4.0)
    print(f"SNR {low:.1f} dB at power 1, {uav.snr_db():.1f} dB at power 4")

    with open(path, "wb") as file:
        file.write(uav.frame())
    print(f"frame in {path}")


if __name__ == "__main__":
    main(*sys.argv[1:3])
