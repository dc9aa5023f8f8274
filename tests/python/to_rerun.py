"""What examples/python/to_rerun.py tells Rerun of a run folder, with a stand-in for Rerun's library, which is large.

    to_rerun.py EXAMPLE FOLDER
"""

import json
import pathlib
import runpy
import sys
from collections import Counter
from unittest.mock import MagicMock

example, folder = sys.argv[1], pathlib.Path(sys.argv[2])
rerun, ticks, rows = MagicMock(), [None], {}


def told(path, thing, **_):
    rows.setdefault(path.split("/", 1)[1], []).append((ticks[0], thing))


def at(timeline, sequence=None, **_):
    if timeline == "tick":
        ticks[0] = sequence


rerun.log, rerun.set_time = told, at
for name in ("Points2D", "LineStrips2D", "Ellipses2D", "Scalars", "EncodedImage"):
    setattr(rerun, name, lambda *args, **named: (*args, *named.values()))
sys.modules.update({"rerun": rerun, "rerun.blueprint": MagicMock()})
sys.argv = [example, str(folder)]
runpy.run_path(example, run_name="__main__")

records = [json.loads(line) for line in (folder / "record.jsonl").read_text().splitlines()]
for record, (tick, (places, *_)), (_, (snr_db,)) in zip(
    records, rows["field/vehicle"], rows["curves/snr_db"], strict=True
):
    assert tick == record["tick"] and places == [[100 * record["r"][0], 100 * (1 - record["r"][1])]], record
    assert abs(snr_db - record["snr_db"]) < 1e-6, record
assert all(contents.startswith(b"\x89PNG") for _, (contents, *_) in rows["field/picture"])
count = Counter({path: len(found) for path, found in rows.items()})
print(count["field/path"], count["field/picture"], count["field/predicted"] > 0)
