"""Message signing between pymavlink and `sitl`, both ways.

    signing.py HOST:PORT KEY FILE          gives a vehicle without a key this one (64 hexadecimal digits)
    signing.py HOST:PORT KEY FILE again    meets it after a restart

FILE takes a frame from before the restart.
"""

import pathlib
import sys
import time

from link import VEHICLE, Link, mavlink

TEN_MICROSECONDS_SINCE_2015 = 1_420_070_400


def timestamp():
    return int((time.time() - TEN_MICROSECONDS_SINCE_2015) * 1e5)


class SigningLink(Link):
    """A link that can send what must be refused, and sees that it was."""

    def sign(self, key):
        self.connection.setup_signing(key, sign_outgoing=True, initial_timestamp=timestamp(), link_id=7)
        self.signing = self.connection.mav.signing

    def ping(self, number, old=False):
        """The bytes of a PING as they would be sent now."""
        return self.send.ping_encode(0, number, 0, 0).pack(self.send, force_mavlink1=old)

    def answered(self, *frames):
        """The numbers of the PINGs among these frames that are answered."""
        for frame in frames:
            self.connection.write(frame)
        return [pong.seq for pong in self.heard_before_pong("PING") if pong.seq >= 1000]


def meet(link, key):
    """A vehicle without a key takes the first one that it is sent, and signs from then on."""
    assert link.answered(link.ping(1000)) == [1000]
    link.send.setup_signing_send(1, VEHICLE, key, timestamp())
    link.sign(key)
    # What was on its way is not signed yet.
    link.signing.allow_unsigned_callback = lambda *_: True
    link.heard_before_pong("PING")
    link.signing.allow_unsigned_callback = None

    def require():
        link.send.param_set_send(1, VEHICLE, b"SIGN_REQUIRED", 1.0, mavlink.MAV_PARAM_TYPE_INT32)

    link.wait_for("PARAM_VALUE", VEHICLE, also=require, where=lambda m: m.param_id == "SIGN_REQUIRED")


def refusals(link, key):
    """Unsigned, signed with another key, in MAVLink 1, too old, or heard before: no answer."""
    good = link.ping(1001)
    assert link.answered(good) == [1001]
    assert link.answered(good) == [], "a replay was answered"
    link.signing.sign_outgoing = False
    unsigned, old = link.ping(1002), link.ping(1003, old=True)
    link.signing.sign_outgoing = True
    link.signing.secret_key = bytes(32 * [1])
    forged = link.ping(1004)
    link.signing.secret_key = key
    # Another link id is another stream, of which nothing newer has been heard.
    link.signing.link_id, link.signing.timestamp = 8, timestamp() - 2 * 60 * 100_000
    late = link.ping(1005)
    link.signing.link_id, link.signing.timestamp = 7, timestamp()
    spoilt = bytearray(link.ping(1006))
    spoilt[-1] ^= 1
    assert link.answered(unsigned, old, forged, late, bytes(spoilt), link.ping(1007)) == [1007]


def main(address, key, file, again):
    link, key, file = SigningLink(address), bytes.fromhex(key), pathlib.Path(file)
    if again:
        link.sign(key)
        assert link.answered(file.read_bytes()) == [], "a frame from before the restart was answered"
    else:
        meet(link, key)
    refusals(link, key)
    file.write_bytes(link.ping(1010))
    assert link.answered(file.read_bytes()) == [1010]
    good, bad = link.signing.goodsig_count, link.signing.badsig_count
    assert good > 5 and bad == 0, (good, bad)
    print(f"{good} messages of the vehicle signed, as pymavlink counts them, {bad} badly")
    print("ok")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4:] == ["again"])
