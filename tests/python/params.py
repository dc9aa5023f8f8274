"""The parameter protocol of `sitl` by pymavlink: list, read, set, and what must be refused.

    params.py HOST:PORT
"""

import math
import sys

from link import RADIO, VEHICLE, Link, mavlink

REAL32 = mavlink.MAV_PARAM_TYPE_REAL32


def everything(link, component):
    """All parameters of a component by name."""
    found = {}

    def done(message):
        if message.get_type() == "PARAM_VALUE" and message.get_srcComponent() == component:
            found[message.param_index] = message
        return len(found) > 0 and len(found) == next(iter(found.values())).param_count

    link.wait(f"all parameters of {component}", done, also=lambda: link.send.param_request_list_send(1, component))
    assert sorted(found) == list(range(len(found))), sorted(found)
    assert len({m.param_id for m in found.values()}) == len(found), "a name came twice"
    return {message.param_id: message for message in found.values()}


def answer(link, name, component, ask):
    """The PARAM_VALUE of this name that `ask` brings about."""
    return link.wait_for("PARAM_VALUE", component, also=ask, where=lambda m: m.param_id == name)


def read(link, name, component=VEHICLE):
    return answer(
        link, name, component, lambda: link.send.param_request_read_send(1, component, name.encode(), -1)
    ).param_value


def set_(link, name, value, component=VEHICLE, kind=REAL32):
    return answer(
        link, name, component, lambda: link.send.param_set_send(1, component, name.encode(), value, kind)
    ).param_value


def main(address):
    link = Link(address)
    version = link.request("AUTOPILOT_VERSION", mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST, version
    assert not version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE, version

    ours, radio = everything(link, VEHICLE), everything(link, RADIO)
    assert "RADIO_TXP" in radio and "RATE_ATTITUDE" in ours, (ours, radio)
    assert ours["SYSID_THISMAV"].param_type == mavlink.MAV_PARAM_TYPE_INT32, ours["SYSID_THISMAV"]
    assert all(math.isfinite(m.param_value) for m in ours.values())
    print(f"{len(ours)} parameters of the vehicle, {len(radio)} of its radio")

    # By name and by index it is the same value.
    index = ours["DYN_A_MAX"].param_index
    by_index = answer(
        link, "DYN_A_MAX", VEHICLE, lambda: link.send.param_request_read_send(1, VEHICLE, b"", index)
    )
    assert by_index.param_value == read(link, "DYN_A_MAX") == ours["DYN_A_MAX"].param_value

    assert set_(link, "RATE_ATTITUDE", 8.0) == 8.0 and read(link, "RATE_ATTITUDE") == 8.0
    for bad in (math.nan, math.inf, -math.inf, -1.0, 1e9):
        assert set_(link, "RATE_ATTITUDE", bad) == 8.0, f"took {bad}"
    assert set_(link, "SCALE_UNIT_M", 1.0) == ours["SCALE_UNIT_M"].param_value, "read only"
    assert set_(link, "GOAL_N", 200.0) == 200.0, "for the next boot"
    for bad in (math.nan, 2.0):
        assert set_(link, "RADIO_TXP", bad, RADIO) in (1.0, 4.0), f"took {bad}"
    assert set_(link, "RADIO_TXP", 4.0, RADIO) == 4.0

    # Whatever else it says of a name that it does not have, it invents no value; and another vehicle's
    # parameters are none of its business.
    link.heard_before_pong("PARAM_VALUE")
    link.send.param_request_read_send(1, VEHICLE, b"NO_SUCH", -1)
    link.send.param_set_send(1, VEHICLE, b"NO_SUCH", 1.0, REAL32)
    link.send.param_request_read_send(1, VEHICLE, b"", 9999)
    link.send.param_request_list_send(2, VEHICLE)
    values = link.heard_before_pong("PARAM_VALUE")
    assert values == [], values
    print("ok")


if __name__ == "__main__":
    main(sys.argv[1])
