"""A peer of `sitl` made of nothing but pymavlink: it shares no code, and no mistake, with ours.

Frame: NED in metres; north is the paper's y and a picture's row, east its x and a column.
"""

import io
import os
import time

os.environ["MAVLINK20"] = "1"

from PIL import Image  # noqa: E402
from pymavlink import mavutil  # noqa: E402

mavlink = mavutil.mavlink

VEHICLE = mavlink.MAV_COMP_ID_AUTOPILOT1
RADIO = mavlink.MAV_COMP_ID_TELEMETRY_RADIO
ACCELERATION_ONLY = 3135
SET_TX_POWER = mavlink.MAV_CMD_USER_1
METRES_PER_PIXEL = 5.0

# Reached only by a failure; a busy machine needs less.
PATIENCE_S = 120.0


class Picture:
    """A frame that came by the image protocol, and where the vehicle said it was just before."""

    def __init__(self, data, position):
        assert data.startswith(b"\x89PNG\r\n\x1a\n"), f"no PNG: {data[:8]!r}"
        self.image = Image.open(io.BytesIO(data))
        self.image.load()
        self.position = position

    def red_disc(self):
        """North and east of the red disc's centre of mass, in metres, and its mass in pixels."""
        image = self.image.convert("RGB")
        width, height = image.size
        mass = north = east = 0.0
        for row in range(height):
            for column in range(width):
                red = image.getpixel((column, row))[0] / 255.0
                mass += red
                north += red * (row + 0.5)
                east += red * (column + 0.5)
        assert mass > 0.0, "nothing red in the picture"
        return north / mass * METRES_PER_PIXEL, east / mass * METRES_PER_PIXEL, mass


class Link:
    """A connection that keeps what it hears: the newest of each message, and whole pictures."""

    def __init__(self, address):
        self.connection = mavutil.mavlink_connection(
            f"udpout:{address}", dialect="common", source_system=250, source_component=190
        )
        self.newest = {}
        self.picture = None
        self.handshake = None
        self.chunks = {}
        self.last_heartbeat = 0.0
        self.pings = 0

    @property
    def send(self):
        return self.connection.mav

    def wait(self, what, found, also=lambda: None):
        """Reads on until `found(message)` is true, and returns that message.

        `also` is called four times a second meanwhile.
        """
        deadline = time.monotonic() + PATIENCE_S
        last = 0.0
        while time.monotonic() < deadline:
            now = time.monotonic()
            if now - self.last_heartbeat >= 1.0:
                self.last_heartbeat = now
                self.send.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
            if now - last >= 0.25:
                last = now
                also()
            message = self.connection.recv_match(blocking=True, timeout=0.05)
            if message is None:
                continue
            assert message.get_type() != "BAD_DATA", f"bad data: {message}"
            self._keep(message)
            if found(message):
                return message
        heard = sorted({kind for kind, _ in self.newest})
        raise AssertionError(f"waited {PATIENCE_S} s for {what}; heard {heard}")

    def wait_for(self, kind, component=None, also=lambda: None, where=lambda message: True):
        """Waits for a message of this kind (and component) for which `where` holds."""
        return self.wait(
            kind,
            lambda m: m.get_type() == kind
            and component in (None, m.get_srcComponent())
            and where(m),
            also,
        )

    def wait_for_picture(self, also=lambda: None):
        """Waits for the next whole picture."""
        self.picture = None
        self.wait("a whole picture", lambda _: self.picture is not None, also)
        return self.picture

    def named_value(self, name, component=RADIO, where=lambda value: True):
        """Waits for the next NAMED_VALUE_FLOAT of this name for which `where` holds."""
        return self.wait_for(
            "NAMED_VALUE_FLOAT", component, where=lambda m: m.name == name and where(m.value)
        ).value

    def accelerate(self, north, east, boot_ms=0):
        """Asks for an acceleration, m/s2. Nothing else is in the message."""
        ignored = 0.0
        self.send.set_position_target_local_ned_send(
            boot_ms, 1, VEHICLE, mavlink.MAV_FRAME_LOCAL_NED, ACCELERATION_ONLY,
            ignored, ignored, ignored, ignored, ignored, ignored, north, east, 0.0, ignored, ignored,
        )  # fmt: skip

    def command(self, command, *params, component=VEHICLE):
        """Sends a COMMAND_LONG until it is acknowledged, and returns the acknowledgement."""
        params = list(params) + [0.0] * (7 - len(params))
        tries = iter(range(256))
        return self.wait_for(
            "COMMAND_ACK",
            component,
            where=lambda m: m.command == command,
            also=lambda: self.send.command_long_send(1, component, command, next(tries), *params),
        )

    def request(self, kind, number):
        """Asks for one message by its number and returns it."""
        ask = mavlink.MAV_CMD_REQUEST_MESSAGE
        return self.wait_for(
            kind, also=lambda: self.send.command_long_send(1, VEHICLE, ask, 0, number, 0, 0, 0, 0, 0, 0)
        )

    def heard_before_pong(self, kind):
        """Sends a PING and returns the messages of this kind that come before its answer, which makes
        a silence visible: what was sent before the PING has been dealt with when it is answered."""
        self.pings += 1
        heard = []

        def pong(message):
            if message.get_type() == kind:
                heard.append(message)
            return message.get_type() == "PING" and message.seq == self.pings

        self.send.ping_send(int(time.time() * 1e6), self.pings, 0, 0)
        answer = self.wait("the answer to a PING", pong)
        assert (answer.target_system, answer.target_component) == (250, 190), answer
        return heard

    def request_pictures(self):
        """Asks for a stream of PNG pictures; all but the type and the quality is zero."""
        self.send.data_transmission_handshake_send(mavlink.MAVLINK_DATA_STREAM_IMG_PNG, 0, 0, 0, 0, 0, 100)

    def stop_pictures(self):
        """Ends the stream: all zero."""
        self.send.data_transmission_handshake_send(0, 0, 0, 0, 0, 0, 0)

    def _keep(self, message):
        kind = message.get_type()
        self.newest[kind, message.get_srcComponent()] = message
        if kind == "DATA_TRANSMISSION_HANDSHAKE" and message.packets > 0:
            position = self.newest.get(("LOCAL_POSITION_NED", VEHICLE))
            self.handshake, self.chunks = (message, position), {}
        elif kind == "ENCAPSULATED_DATA" and self.handshake is not None:
            announced, position = self.handshake
            self.chunks[message.seqnr] = bytes(message.data)[: announced.payload]
            if len(self.chunks) == announced.packets:
                data = b"".join(self.chunks[i] for i in range(announced.packets))
                self.picture = Picture(data[: announced.size], position)
                self.handshake, self.chunks = None, {}
