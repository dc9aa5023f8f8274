"""Writes corpus/: the inputs that the fuzz targets begin with. Python's standard library alone.

    python3 tests/fuzz/corpus.py

Each input is small and is one that the program under test accepts. Scenario and radio files come from
configs/, where they are used.
"""

import json
import math
import shutil
import struct
import zlib
from pathlib import Path

HERE = Path(__file__).resolve().parent
# CRC_EXTRA of common.xml for the messages that are written here.
EXTRA = {0: 50, 11: 89, 20: 214, 21: 159, 23: 168, 30: 39, 39: 254, 44: 221, 51: 196, 66: 148, 73: 38, 75: 158, 76: 152,
         84: 143, 86: 5, 111: 34, 130: 29, 131: 223, 256: 71}
# Indices into IDS of src/vehicle.rs and of src/router.rs.
VEHICLE_IDS = [0, 2, 4, 11, 20, 21, 22, 23, 37, 38, 39, 40, 41, 43, 44, 45, 47, 51, 66, 73, 75, 76, 84, 85, 86, 110, 111,
               130, 131, 253, 256, 345]
ROUTER_IDS = [0, 4, 11, 22, 30, 69, 70, 75, 76, 77, 82, 84, 86, 111, 256, 300]


def command(number, *params, target=(1, 1)):
    params = [*params, *[0.0] * 7][:7]
    return 76, struct.pack("<7fHBBB", *params, number, *target, 0)


def item(seq, number, *params, kind=0, current=0):
    params = [*params, *[0.0] * 4][:4]
    place = struct.pack("<iif", 473977420 + 900 * seq, 85455940, 50.0)
    return 73, struct.pack("<4f", *params) + place + struct.pack("<HHBBBBBB", seq, number, 1, 1, 6, current, 1, kind)


def param(name, value, kind=9):
    return 23, struct.pack("<fBB16sB", value, 1, 1, name.encode(), kind)


def setpoint(mask, *numbers, frame=1):
    numbers = [*numbers, *[0.0] * 11][:11]
    return 84, struct.pack("<I11fHBBB", 0, *numbers, mask, 1, 1, frame)


HEARTBEAT = (0, struct.pack("<IBBBBB", 0, 6, 8, 0, 4, 3))
COUNT = lambda n, kind=0: (44, struct.pack("<HBBB", n, 1, 1, kind))
IMAGE_REQUEST = (130, struct.pack("<IHHHBBB", 0, 0, 0, 0, 5, 0, 0))

SESSIONS = {
    "setpoints": [setpoint(3135, *[0] * 6, 2.0), setpoint(0x0DF8, 100, 50, -20), setpoint(0x0DC7, 0, 0, 0, 3, 1, 0, frame=8)],
    "commands": [command(400, 1.0), command(22, *[0] * 6, 20.0), command(192, -1, 0, 0, math.nan, 47.4, 8.5, 600), command(20),
                 command(21), command(176, 81, 17), command(178, 1, 3, -1), command(115, 90, 20, 1, 0)],
    "requests": [command(511, 30, 100000), command(511, 33, -1), command(512, 148), command(510, 30), command(520, 1),
                 (66, struct.pack("<HBBBB", 4, 1, 1, 10, 1)), (111, struct.pack("<qq", 0, 123456))],
    "camera": [IMAGE_REQUEST, command(521, 1), command(2000, 0, 0.4, 3, 1), command(2001), command(246, 1)],
    "params": [(21, b"\1\1"), (20, struct.pack("<hBB16s", -1, 1, 1, b"RATE_ATTITUDE")), param("RATE_GPS", 5e-20),
               param("FENCE_ACTION", 1.0), param("OBST_RADIUS", 0.2), param("CH_B_DT", 2.75)],
    "mission": [COUNT(4), item(0, 16), item(1, 22), item(2, 177, 1, 3), item(3, 20), (51, struct.pack("<HBBB", 1, 1, 1, 0)),
                command(300), (11, struct.pack("<IBB", 3, 1, 1))],
    "fence": [COUNT(3, 1), *[item(k, 5001, 3, kind=1) for k in range(3)], COUNT(1, 2), item(0, 5100, kind=2)],
    "signing": [(256, struct.pack("<QBB32s", 7, 1, 1, bytes(range(32)))), HEARTBEAT],
}


def crc(data):
    value = 0xFFFF
    for byte in data:
        low = (byte ^ value) & 0xFF
        low = (low ^ (low << 4)) & 0xFF
        value = (value >> 8) ^ (low << 8) ^ (low << 3) ^ (low >> 4)
    return value & 0xFFFF


def frame(number, message, source=(255, 190)):
    kind, payload = message
    payload = payload.rstrip(b"\0") or b"\0"
    head = struct.pack("<BBBBBB", len(payload), 0, 0, number & 255, *source) + kind.to_bytes(3, "little")
    return b"\xfd" + head + payload + struct.pack("<H", crc(head + payload + bytes([EXTRA[kind]])))


def save(target, name, data):
    folder = HERE / "corpus" / target
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(side=100, tick=b"7"):
    rows = b"".join(b"\0" + bytes([240, 240, 240]) * side for _ in range(side))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0))
            + chunk(b"tEXt", b"tick\0" + tick) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b""))


def links():
    for name, session in SESSIONS.items():
        frames = [frame(k, message) for k, message in enumerate([HEARTBEAT, *session])]
        save("decoder", name, b"\xfe" + b"".join(frames))
        save("decoder", f"{name}-cut", b"\x15" + b"junk".join(frames))
        steps = b"".join(bytes([0, VEHICLE_IDS.index(kind), len(payload)]) + payload + b"\6" for kind, payload in [HEARTBEAT, *session])
        save("vehicle", name, b"\x08" + steps + b"\7\x90\1\6" * 4)
        save("vehicle", f"{name}-live", b"\x1c" + steps + b"\7\x90\1\6" * 4)
        known = [(kind, payload) for kind, payload in [HEARTBEAT, *session] if kind in ROUTER_IDS]
        steps = b"".join(bytes([(k % 8) << 5, ROUTER_IDS.index(kind), k, 1, 1, len(payload)]) + payload
                         for k, (kind, payload) in enumerate(known * 3))
        save("router", name, b"\7" + steps + b"\6\xff\xff" + steps + b"\7")
        stamp = 1_700_000_000_000_000
        save("tlog", name, b"".join((stamp + k * 100_000).to_bytes(8, "big") + one for k, one in enumerate(frames)))
    save("tlog", "cut", (1).to_bytes(8, "big") + frame(0, HEARTBEAT) + b"\0\0\1\2\3")


def pictures():
    whole = png()
    save("image", "picture", b"\0" + whole)
    save("image", "small", b"\0" + png(8))
    parts = [whole[k:k + 253] for k in range(0, len(whole), 253)]
    steps = bytes([0, 13]) + struct.pack("<IHHHBBB", len(whole), 100, 100, len(parts), 5, 253, 50)
    for k, part in enumerate(parts):
        steps += bytes([1, 255]) + struct.pack("<H", k) + part.ljust(253, b"\0")
    save("image", "messages", b"\1" + steps)


def missions():
    rows = ["0\t1\t0\t16\t0\t0\t0\t0\t47.397742\t8.545594\t488\t1", "1\t0\t3\t22\t15\t0\t0\t0\t0\t0\t20\t1",
            "2\t0\t3\t16\t0\t0\t0\t0\t47.398\t8.546\t20\t1", "3\t0\t3\t177\t1\t-1\t0\t0\t0\t0\t0\t1", "4\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1"]
    save("mission", "wpl", "QGC WPL 110\n" + "\n".join(rows) + "\n")
    save("mission", "wpl-comments", "# made by hand\n\nQGC WPL 120\n" + rows[0].replace("16", "16.000000") + " # home\n")
    simple = {"type": "SimpleItem", "command": 16, "frame": 3, "autoContinue": True, "doJumpId": 1,
              "params": [0, 0, 0, None, 47.398, 8.546, 50]}
    jump = simple | {"command": 177, "frame": 2, "doJumpId": 2, "params": [1, 3, 0, 0, 0, 0, 0]}
    survey = {"type": "ComplexItem", "complexItemType": "survey", "TransectStyleComplexItem": {"Items": [simple]}}
    corner = [[47.39, 8.54], [47.4, 8.54], [47.4, 8.55]]
    fence = {"version": 2, "circles": [{"circle": {"center": [47.4, 8.5], "radius": 100}, "inclusion": True, "version": 1}],
             "polygons": [{"polygon": corner, "inclusion": False, "version": 1}], "breachReturn": [47.4, 8.5, 50]}

    def plan(items, **more):
        mission = {"version": 2, "plannedHomePosition": [47.397742, 8.545594, None], "items": items}
        return json.dumps({"fileType": "Plan", "version": 1, "mission": mission} | more)

    save("mission", "plan", plan([simple, jump]))
    save("mission", "survey", plan([survey]))
    save("mission", "fence", plan([], geoFence=fence, rallyPoints={"version": 2, "points": [[47.4, 8.5, 50]]}))


def parameters():
    save("params", "mavproxy", "# two\nRATE_GPS         2.000000\nFENCE_ACTION,1\n")
    save("params", "columns", "# Vehicle-Id Component-Id Name Value Type\n1\t1\tFENCE_ACTION\t1\t6\n2\t68\tRADIO_TXP\t4\t9\n")
    save("params", "numbers", "A -128\nB 4294967295\nC 1e-45\nD -2147483648\nE inf\nF nan\nG 0.1\n")


def records():
    line = {"tick": 0, "r": [0.2, 0.5], "v": [0.0, 0.0], "wish": [1.0, 0.0], "power": 4, "snr_db": 9.5, "outage": False,
            "flown_tick": 0, "flown": [1.0, 0.0], "r_next": [0.2, 0.5], "v_next": [0.01, 0.0], "obstacles": [[0.5, 0.5]],
            "p_coll": 0.001, "collided": False, "edge": False}
    missed = line | {"tick": 1, "power": 1, "outage": True, "flown_tick": None}
    save("record", "two", json.dumps(line) + "\n" + json.dumps(missed) + "\n")
    save("record", "late", json.dumps(line | {"tick": 2**63}) + "\n")


def checkpoints():
    header = json.dumps({"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}}).encode()
    save("checkpoint", "tensors", b"\0" + len(header).to_bytes(8, "little") + header + bytes(8))
    for kind in (1, 2, 3):
        save("checkpoint", f"change-{kind}", bytes([kind]) + struct.pack("<HB", 0, 0x38))
        save("checkpoint", f"as-it-is-{kind}", bytes([kind]))


shutil.rmtree(HERE / "corpus", ignore_errors=True)
links()
pictures()
missions()
parameters()
records()
checkpoints()
