"""Reads the files that `gcs export` wrote of one run folder with the programs that people have: DuckDB, gpxpy, the
reference reader of MCAP, and Python's own JSON; and compares them with record.jsonl.

    read_export.py FOLDER
"""

import base64
import io
import json
import pathlib
import sys

import duckdb
import gpxpy
from mcap.reader import make_reader
from PIL import Image

folder = pathlib.Path(sys.argv[1])
records = [json.loads(line) for line in (folder / "record.jsonl").read_text().splitlines()]

table, text = f"'{folder}/flight.parquet'", f"read_csv('{folder}/flight.csv')"
rows = duckdb.sql(f"select * from {table}")
differences = duckdb.sql(f"(select * from {table} except all select * from {text})")
snr = [row[0] for row in duckdb.sql(f"select snr_db from {table} order by tick").fetchall()]
assert all(abs(a - b["snr_db"]) < 1e-4 for a, b in zip(snr, records, strict=True))
print(f"table: {len(rows)} rows, {len(differences)} differences")

(track,) = gpxpy.parse((folder / "flight.gpx").read_text()).tracks
points = track.segments[0].points
length, seconds = track.length_2d(), (points[-1].time - points[0].time).total_seconds()
print(f"gpx: {len(points)} points, {seconds:.1f} s")
places = [row[:2] for row in duckdb.sql(f"select latitude_deg, longitude_deg from {table}").fetchall()]
assert all(abs(p.latitude - a) < 1e-7 and abs(p.longitude - b) < 1e-7 for p, (a, b) in zip(points, places, strict=True))
assert 100 < length < 2000, length

features = json.loads((folder / "flight.geojson").read_text())["features"]
line = features[0]["geometry"]
outages = sum(feature["properties"]["name"] == "outage" for feature in features)
print(f"geojson: {line['type']} of {len(line['coordinates'])}, {outages == sum(r['outage'] for r in records)}")

with (folder / "flight.mcap").open("rb") as stream:
    reader = make_reader(stream)
    summary = reader.get_summary()
    messages = list(reader.iter_messages())
    flown = [json.loads(m.data) for _, channel, m in messages if channel.topic == "/record"]
    notes = [note.metadata for note in reader.iter_metadata()]
assert flown == records and "config.toml" in notes[0]
times = [m.log_time for _, _, m in messages]
assert times == sorted(times)
# The UAV is red, and north is up; where it crosses the blue obstacle nothing is asked.
pictures = [json.loads(m.data) for _, channel, m in messages if channel.topic == "/vehicle_1/picture"]
red = 0
for record, picture in zip(records, pictures, strict=True):
    image = Image.open(io.BytesIO(base64.b64decode(picture["data"])))
    x, y = record["r"]
    red += image.getpixel((min(99, int(100 * x)), min(99, int(100 * (1 - y)))))[0] > 100
topics = {channel.topic for channel in summary.channels.values()}
print(f"mcap: {len(messages)} messages, {summary.statistics.message_count} told, {len(topics)} topics, "
      f"red at the UAV's place in {red} pictures")
