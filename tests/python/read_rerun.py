"""Reads the flight.rrd that examples/python/to_rerun.py wrote of a run folder, with Rerun's own reader, and compares it
with record.jsonl. By hand, in an environment with rerun-sdk, which takes 790 MB.

    read_rerun.py FOLDER
"""

import json
import pathlib
import sys

from rerun.chunk import RrdReader

folder = pathlib.Path(sys.argv[1])
records = [json.loads(line) for line in (folder / "record.jsonl").read_text().splitlines()]
rows = {}
for chunk in RrdReader(folder / "flight.rrd").stream().to_chunks():
    if "tick" in chunk.timeline_names:
        batch = chunk.to_record_batch()
        for row in batch.select([name for name in batch.schema.names if name == "tick" or ":" in name]).to_pylist():
            rows.setdefault(chunk.entity_path.split("/", 2)[2], {})[row["tick"]] = row

for record in records:
    (place,) = rows["field/vehicle"][record["tick"]]["Points2D:positions"]
    (snr_db,) = rows["curves/snr_db"][record["tick"]]["Scalars:scalars"]
    assert max(abs(place[0] - 100 * record["r"][0]), abs(100 - place[1] - 100 * record["r"][1])) < 1e-4, record
    assert abs(snr_db - record["snr_db"]) < 1e-4, record
print(f"{len(records)} positions and SNRs are those of record.jsonl")
print(", ".join(f"{path} {len(found)}" for path, found in sorted(rows.items())))
