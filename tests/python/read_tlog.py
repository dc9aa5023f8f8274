"""Reads a tlog with pymavlink and prints what is in it as one line of JSON.

    read_tlog.py FILE

Fails on bytes that are no message, on a time that goes back and on a gap in a sequence.
"""

import collections
import json
import os
import sys

os.environ["MAVLINK20"] = "1"

from pymavlink import mavutil  # noqa: E402


def main(path):
    log = mavutil.mavlink_connection(path, dialect="common")
    kinds = collections.Counter()
    sequences = {}
    first = last = None
    gaps = 0
    while True:
        message = log.recv_match()
        if message is None:
            break
        kind = message.get_type()
        assert kind != "BAD_DATA", f"bad data after {sum(kinds.values())} messages: {message}"
        source = message.get_srcSystem(), message.get_srcComponent()
        sequence = message.get_seq()
        if source in sequences and sequence != (sequences[source] + 1) % 256:
            gaps += 1
        sequences[source] = sequence
        kinds["{}/{} {}".format(*source, kind)] += 1
        time = message._timestamp
        assert last is None or time >= last, f"{kind}: time went back by {last - time} s"
        first = time if first is None else first
        last = time
    print(json.dumps({"first": first, "last": last, "gaps": gaps, "kinds": dict(sorted(kinds.items()))}))


if __name__ == "__main__":
    main(sys.argv[1])
