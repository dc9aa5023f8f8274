"""Flies `sitl` as any MAVLink program would: listens, pushes north, sets the radio, checks a picture.

    radio_and_camera.py HOST:PORT
"""

import math
import sys

from link import RADIO, SET_TX_POWER, VEHICLE, Link, mavlink


def main(address):
    link = Link(address)

    heartbeat = link.wait_for("HEARTBEAT", VEHICLE)
    assert heartbeat.type == mavlink.MAV_TYPE_QUADROTOR, heartbeat
    assert heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED, heartbeat
    assert heartbeat.get_srcSystem() == 1, heartbeat

    # At rest at the paper's start (0.1, 0.5), 500 m a unit, until somebody pushes.
    position = link.wait_for("LOCAL_POSITION_NED", VEHICLE)
    assert math.isclose(position.x, 250.0, abs_tol=1e-3), position
    assert math.isclose(position.y, 50.0, abs_tol=1e-3), position
    assert position.z < 0.0, position
    print(f"at north {position.x:.1f} m, east {position.y:.1f} m")

    # A broken setpoint is dropped; the good ones around it are flown.
    link.accelerate(math.nan, 0.0)

    def push():
        link.accelerate(5.0, 0.0)

    moved = link.wait_for("LOCAL_POSITION_NED", VEHICLE, also=push, where=lambda m: m.x > 260.0)
    assert moved.vx > 0.0 and abs(moved.y - 50.0) < 1e-3 and abs(moved.vy) < 1e-3, moved
    flown = link.wait_for("POSITION_TARGET_LOCAL_NED", VEHICLE, also=push)
    assert flown.type_mask == 3135 and math.isclose(flown.afx, 5.0, abs_tol=1e-6), flown
    print(f"pushed north: north {moved.x:.1f} m at {moved.vx:.1f} m/s")

    def brake():
        newest = link.newest["LOCAL_POSITION_NED", VEHICLE]
        link.accelerate(max(-5.0, min(5.0, -newest.vx)), 0.0)

    def named(name, where):
        return link.wait_for(
            "NAMED_VALUE_FLOAT", RADIO, also=brake, where=lambda m: m.name == name and where(m.value)
        )

    # The transmitter's power, by command and by parameter.
    low = named("SNR_DB", lambda snr: True).value
    ack = link.command(SET_TX_POWER, 4.0, component=RADIO)
    assert ack.result == mavlink.MAV_RESULT_ACCEPTED, ack
    assert (ack.target_system, ack.target_component) == (250, 190), ack
    named("TXP", lambda level: level == 4.0)
    high = named("SNR_DB", lambda snr: True).value
    assert high > low + 3.0, f"four times the power: {low:.2f} dB to {high:.2f} dB"
    ack = link.command(SET_TX_POWER, 2.0, component=RADIO)
    assert ack.result == mavlink.MAV_RESULT_DENIED, ack
    ack = link.command(31_289)
    assert ack.result == mavlink.MAV_RESULT_UNSUPPORTED, ack

    def set_power():
        link.send.param_set_send(1, RADIO, b"RADIO_TXP", 1.0, mavlink.MAV_PARAM_TYPE_REAL32)

    echo = link.wait_for("PARAM_VALUE", RADIO, also=set_power)
    assert echo.param_id == "RADIO_TXP" and echo.param_value == 1.0, echo
    named("TXP", lambda level: level == 1.0)
    named("OUTAGE", lambda outage: outage in (0.0, 1.0))
    link.wait_for("RADIO_STATUS", RADIO, also=brake)
    print(f"power: SNR {low:.1f} dB at 1, {high:.1f} dB at 4")

    # Pictures come when they are asked for.
    assert link.picture is None, "a picture that nobody asked for"
    link.request_pictures()
    for _ in range(3):
        picture = link.wait_for_picture(also=brake)
        assert picture.image.size == (100, 100), picture.image.size
        north, east, mass = picture.red_disc()
        said = picture.position
        assert math.hypot(north - said.x, east - said.y) < 0.5, (
            f"the red disc is at north {north:.2f} m, east {east:.2f} m; "
            f"the vehicle says {said.x:.2f}, {said.y:.2f}"
        )
        assert 15.0 < mass < 19.0, f"{mass:.2f} px of red"
    print(f"picture: red disc at north {north:.2f} m, east {east:.2f} m, said {said.x:.2f}, {said.y:.2f}")
    link.stop_pictures()
    link.wait_for(
        "DATA_TRANSMISSION_HANDSHAKE", VEHICLE, also=brake, where=lambda m: m.size == m.packets == 0
    )
    print("ok")


if __name__ == "__main__":
    main(sys.argv[1])
